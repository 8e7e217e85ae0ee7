"""Every error about what a user gave says what to change."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import roigs_engine
from roigs_engine import errors

ENGINE = Path(roigs_engine.__file__).parent
ROOMS = ("formats", "colmap", "selection", "commands", "evaluation", "run")
KINDS = {name for name in dir(errors) if name.endswith("Error")} | {"kind"}


@pytest.mark.parametrize("room", ROOMS)
def test_every_error_has_a_hint(room: str) -> None:
    without = []
    for path in sorted((ENGINE / room).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            call = node.exc if isinstance(node, ast.Raise) else None
            raised = isinstance(call, ast.Call) and getattr(call.func, "id", "") in KINDS
            if raised and len(call.args) < 2 and not call.keywords:
                without.append(f"{path.relative_to(ENGINE)}:{call.lineno}")
    assert not without
