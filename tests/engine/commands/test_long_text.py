"""Text of a stranger is searched in a time that grows with its length, and no faster.

A search that goes on for hours would hear no Ctrl-C either.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from roigs_engine.cli import main
from roigs_engine.exchange.libraries import reading
from roigs_engine.formats.splat_ply import made_of, up_axis
from roigs_engine.requests.values import LONGEST, without_secrets
from tests.engine.commands.command_line import refused
from tests.fuzz import inputs

LETTERS = 200_000
MOST_SECONDS = 4.0  # before, each of these took from 8 to 700 of them
PARTS = ("//a:", "http://a", "://", "//::::", "?", "://a", "[", "a@", " ")


@pytest.fixture(autouse=True)
def soon() -> Iterator[None]:
    began = time.process_time()
    yield
    assert time.process_time() - began < MOST_SECONDS


def many(part: str) -> str:
    return part * (LETTERS // len(part))


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("key", ["method", "images", "only", "count"])
def test_values_of_an_options_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], key: str, part: str
) -> None:
    file = tmp_path / "options.json"
    values = {"scene": "nowhere", key: [many(part)] if key == "only" else many(part)}
    file.write_text(json.dumps(values), encoding="utf-8")
    assert len(refused(capsys, "select", file)) < 2000


@pytest.mark.parametrize("part", PARTS)
def test_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str], part: str) -> None:
    table = tmp_path / "table.toml"
    text = f'[scenes.hall]\nscene = "x"\nmade_for = """\n{many(part)}\n"""\n'
    table.write_text(text, encoding="utf-8")
    assert main(["batch", str(table), "--run-dir", str(tmp_path / "run")]) == 2
    assert "'made_for'" in capsys.readouterr().err


@pytest.mark.parametrize("part", [" at line 1 in file ", " at line 1 in file x : '", "\n"])
def test_an_error_of_openusd(tmp_path: Path, part: str) -> None:
    path = tmp_path / "a.usda"
    path.write_text("#usda 1.0")
    with pytest.raises(Exception, match="is not a whole OpenUSD file"), reading(path, "OpenUSD"):
        raise RuntimeError(many(part))


SAID = ("up axis X", "vertical axis", "made_for a", "photo_focal 1", "SplatRenderMode: mip")


@pytest.mark.parametrize("said", SAID)
@pytest.mark.parametrize("part", [" ", "\t", "_", "-", "1"])
def test_a_comment_of_a_ply(tmp_path: Path, said: str, part: str) -> None:
    path, line = tmp_path / "a.ply", f"\ncomment {said}{many(part)}Y\nelement"
    path.write_bytes(inputs.good_ply().replace(b"\nelement", line.encode(), 1))
    assert up_axis(path) in (None, (0.0, 1.0, 0.0))  # a long space means what a short one does
    assert made_of(path)["photo_focal"] is None


def test_a_password_that_is_cut_off_is_not_shown() -> None:
    """Its end, by which it would be known, is not looked at."""
    shown = without_secrets(f"see ftp://me:{'hidden' * LONGEST}@host/x")
    assert shown == "see ..."
    assert without_secrets(f"http://me:hidden@host {many('x')}").startswith("http://...@host ")
    assert without_secrets(many("x")) == many("x")[:LONGEST]
