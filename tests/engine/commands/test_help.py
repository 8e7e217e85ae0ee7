"""Help and version, and the commands that the documents show."""

from __future__ import annotations

import re
import shlex

import pytest

import roigs_engine
from roigs_engine.cli import main
from roigs_engine.commands.parser import build_parser, parsed
from roigs_engine.commands.table import COMMANDS
from tests.engine.commands.command_line import ROOT, python


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_every_command_has_help_with_examples(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as left:
        main([command, "--help"])
    assert left.value.code == 0
    out = capsys.readouterr().out
    assert "examples:" in out
    assert f"python -m roigs_engine {command} " in out
    assert "--events" in out


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_examples_in_the_help_are_accepted(command: str) -> None:
    examples = COMMANDS[command].examples
    assert examples
    for example in examples:
        words = [command, *shlex.split(example)]
        assert parsed(words)[0] is COMMANDS[command]


def test_help_lists_the_commands_and_version_is_the_packages() -> None:
    shown = python("--help", cold=True)
    assert shown.returncode == 0
    assert all(f"\n    {command}" in shown.stdout for command in COMMANDS)
    assert python("--version", cold=True).stdout.strip() == roigs_engine.__version__


@pytest.mark.parametrize("page", ["README.md", "docs/commands.md", "docs/files.md"])
def test_commands_in_the_documents_are_accepted(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8").replace("\\\n", " ")
    start = "python -m roigs_engine "
    lines = [line.partition(start)[2] for line in text.splitlines() if start in line]
    lines += re.findall(rf"^\| `((?:{'|'.join(COMMANDS)}) .*?)` \|", text, re.MULTILINE)
    commands = [line for line in lines if line.split() and line.split()[0] in COMMANDS]
    assert commands
    for line in commands:
        words = shlex.split(line.rstrip("`").replace("\\", "/"))
        assert build_parser()[0].parse_args(words).command == words[0]


def test_the_reference_of_options_is_that_of_the_declarations() -> None:
    from tools.option_reference import PAGE, page

    assert PAGE.read_text(encoding="utf-8") == page(), "run python -m tools.option_reference"
