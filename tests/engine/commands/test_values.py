"""Every option of every command takes what it says, and refuses the rest in one line."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from roigs_engine.cli import main
from roigs_engine.commands.parser import build_parser, parsed
from roigs_engine.requests.values import Name, Number, Place
from tests.engine.commands.command_line import BOX, refused
from tests.engine.synthetic_colmap import Project

NUMBERS = ("-1", "1e303", "nan", "inf", "1" + "0" * 20, "9" * 5000, "", " ", "text", "1.5.2", "²")
ODD = (True, "3", [1], {}, 10**400, float("nan"), float("inf"), -1e303)


def options(kind: type) -> Iterator[tuple[str, argparse.Action]]:
    """(command, option) of all options with a value of that kind."""
    for command, parser in build_parser()[1].items():
        for action in parser._actions:
            if isinstance(action.type, kind):
                yield command, action


def flag(action: argparse.Action) -> list[str]:
    return list(action.option_strings[:1])


def words(command: str, action: argparse.Action | None, value: str) -> list[str]:
    """A command line that gives the option (None: the scene) a value, and what else it needs."""
    parser = build_parser()[1][command]
    line = [command]
    action = action or next(a for a in parser._actions if a.dest == "scene")
    for other in parser._actions:
        needed = other in parser.needed and other.dest != action.dest
        if needed and other.option_strings:
            usual = "0,0,0" if isinstance(other.type, Place) else "x=y"
            line += [other.option_strings[0], next(iter(other.choices or ()), usual)]
        elif not other.option_strings and other.dest == action.dest:
            line.append(value)
        elif needed:
            line.append("x")
    if not action.option_strings:
        return line
    return [*line, f"{action.option_strings[0]}={value}"]


def names(found: Iterator[tuple[str, argparse.Action]]) -> list[str]:
    return [f"{command} {(flag(action) or [action.dest])[0]}" for command, action in found]


def test_every_option_with_a_value_is_checked() -> None:
    for command, parser in build_parser()[1].items():
        for action in parser._actions:
            takes = action.nargs != 0 and action.choices is None
            assert not takes or isinstance(action.type, (Number, Name)), (command, action.dest)


@pytest.mark.parametrize("name", names(options(Number)))
def test_numbers_outside_their_range(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    command, option = name.split()
    action = build_parser()[1][command]._option_string_actions[option]
    limits = action.type
    assert isinstance(limits, Number)
    outside = [value for value in NUMBERS if not fits(limits, value)]
    outside += [str(limits.low - 1), str(2 * limits.high + 1)]
    for value in outside:
        line = refused(capsys, *words(command, action, value))
        assert option in line and str(limits) in line and len(line) < 250


def fits(limits: Number, text: str) -> bool:
    try:
        limits(text)
    except argparse.ArgumentTypeError:
        return False
    return True


@pytest.mark.parametrize("name", names(options(Name)))
def test_blank_names_and_paths(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    command, option = name.split()
    (action,) = (
        a for c, a in options(Name) if c == command and option in (a.dest, *a.option_strings)
    )
    for value in ("", " ", "\t \n"):
        line = refused(capsys, *words(command, action, value))
        named = action.metavar if not action.option_strings and action.metavar else option
        assert str(named).lower() in line.lower() and "empty" in line


@pytest.mark.parametrize("command", ["inspect", "export", "select", "train", "evaluate"])
def test_an_options_file_has_the_same_ranges(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    parser, path = build_parser()[1][command], tmp_path / "options.json"
    for action in parser._actions:
        if not isinstance(action.type, Number) or action in parser.needed:
            continue
        limits = action.type
        for value in (*ODD, limits.low - 1, 2 * limits.high + 1, 0.5 if limits.integer else []):
            path.write_text(json.dumps({"scene": "x", action.dest: value}), encoding="utf-8")
            line = refused(capsys, *words(command, None, str(path)))
            assert f"'{action.dest}' in " in line and str(limits) in line


def test_an_option_given_twice_is_refused(
    project: Project, capsys: pytest.CaptureFixture[str]
) -> None:
    for option in ("--max-side", "--seed", "--count"):
        line = refused(capsys, "select", project.folder, "--roi", BOX, option, 9, option, 9)
        assert option in line and "twice" in line
    line = refused(capsys, "select", project.folder, "--rois", "a", "--rois", "b")
    assert "--rois" in line and "twice" in line


def test_an_option_may_override_the_file_once(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "options.json"
    record = {"scene": str(project.folder), "roi": BOX, "count": 2}
    path.write_text("\ufeff" + json.dumps(record), encoding="utf-8")  # with a byte order mark
    assert main(["select", str(path), "--count", "3", "--only", "thing", "--only", "thing"]) == 0
    capsys.readouterr()
    assert "twice" in refused(capsys, "select", path, "--count", 3, "--count", 3)


@pytest.mark.parametrize("text", ["A", "=a.ply", "A=", "A= ", " =a.ply"])
def test_a_model_needs_a_name_and_a_file(
    text: str, project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["evaluate", project.folder, "--roi", BOX, "--out", tmp_path / "out"]
    assert "NAME=FILE.ply" in refused(capsys, *command, f"--model={text}")
    command = ["compose", tmp_path / "a.ply", "--roi", BOX, "--out", tmp_path / "out"]
    assert "ROI=FILE.ply" in refused(capsys, *command, f"--object={text}")


def test_addresses_are_for_batch(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = refused(capsys, "run", tmp_path, "--run-dir", "s3://museum/runs")
    assert "'s3://museum/runs' is an address; only `batch` takes one" in said


@pytest.mark.parametrize("line", [["--up", "-y"], ["--up=-y"]])
def test_values_may_begin_with_a_minus(line: list[str]) -> None:
    _, request = parsed(["convert", "a.ply", "b.ply", *line])
    assert request.up == "-y"  # type: ignore[attr-defined]
