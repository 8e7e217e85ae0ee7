"""Limits for the sizes of files and functions, and for files that only one other imports."""

from __future__ import annotations

import ast
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

from tests.project_imports import ADDON, ENGINE, files, imports

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("roigs_engine", "roigs_addon", "benchmarks")
MOST_LINES, FUNCTION_LINES, PARAMETERS = 400, 60, 8
SHARD_LINES = 70
"""What has fewer, with its comments, and one importer belongs into that file."""
# Entries, and parts that are looked up by their name.
LOOKED_UP = ("__main__", "app", "cli", "commands", "exchange", "selection", "training.mechanisms")
# Blender fixes the arguments of `draw_item`; the one way to draw has those of gsplat's function.
# The one way to load a scene says which photos, masks and sizes it uses.
MORE_PARAMETERS = {"draw_item": PARAMETERS + 1, "load_colmap": PARAMETERS + 1, "rasterize": 25}


def modules(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


Function = ast.FunctionDef | ast.AsyncFunctionDef


@cache
def measured(path: Path) -> tuple[int, list[Function]]:
    """A file's lines with code (no comments, blank lines and docstrings), and its functions."""
    text = path.read_text(encoding="utf-8")
    rows = (line.strip() for line in text.splitlines())
    lines = {number for number, row in enumerate(rows, start=1) if row and row[0] != "#"}
    functions: list[Function] = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            assert node.end_lineno is not None
            lines -= set(range(node.lineno, node.end_lineno + 1))
        elif isinstance(node, Function):
            functions.append(node)
    return len(lines), functions


def parameters(function: Function) -> int:
    """Without `self` and `cls`."""
    given = function.args
    names = [a.arg for a in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
    starred = [a for a in (given.vararg, given.kwarg) if a is not None]
    return len([name for name in names if name not in ("self", "cls")]) + len(starred)


@pytest.mark.parametrize("package", PACKAGES)
def test_files_are_small(package: str) -> None:
    sizes = {path: measured(path)[0] for path in modules(package)}
    assert not {str(path): size for path, size in sizes.items() if size > MOST_LINES}


@pytest.mark.parametrize("package", PACKAGES)
def test_functions_are_short_and_take_few_arguments(package: str) -> None:
    for path in modules(package):
        for function in measured(path)[1]:
            assert function.end_lineno is not None
            lines = function.end_lineno - function.lineno + 1
            assert lines <= FUNCTION_LINES, f"{path}: {function.name} has {lines} lines"
            count = parameters(function)
            most = MORE_PARAMETERS.get(function.name, PARAMETERS)
            assert count <= most, f"{path}: {function.name} takes {count} arguments"


def test_a_small_module_of_the_engine_has_two_importers() -> None:
    modules, users = files(ENGINE), Counter[str]()
    for package in (ENGINE, ADDON):
        for name, path in files(package).items():
            users.update({entry.target for entry in imports(path)} - {name})
    for name, path in modules.items():
        short = name.removeprefix(ENGINE).removeprefix(".")
        if path.name == "__init__.py" or short.startswith(LOOKED_UP):
            continue
        lines = len(path.read_text(encoding="utf-8").splitlines())
        assert users[name] > 1 or lines >= SHARD_LINES, f"{name}: {lines} lines for one importer"
