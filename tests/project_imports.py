"""Every import of the project, read from its source."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

ENGINE, ADDON = "roigs_engine", "roigs_addon"


@dataclass(frozen=True)
class Import:
    """`target` as a dotted name.

    `late`: inside a function, run when that is called; `typing`: for the type checker alone.
    """

    target: str
    late: bool
    typing: bool = False


@cache
def files(package: str) -> dict[str, Path]:
    """Dotted name -> file, of every module of a package of the project."""
    found = {}
    for path in sorted((ROOT / package).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@cache
def imports(path: Path) -> tuple[Import, ...]:
    """Everything a file imports, for the type checker too, relative names resolved."""
    package = path.relative_to(ROOT).parts[:-1]
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return tuple(_walk(tree, package, late=False))


def _walk(
    node: ast.AST, package: tuple[str, ...], *, late: bool, typing: bool = False
) -> Iterator[Import]:
    if isinstance(node, ast.If) and _is_for_types(node.test):
        for child in node.body:
            yield from _walk(child, package, late=late, typing=True)
        for child in node.orelse:
            yield from _walk(child, package, late=late, typing=typing)
        return
    if isinstance(node, ast.Import):
        yield from (Import(alias.name, late, typing) for alias in node.names)
    if isinstance(node, ast.ImportFrom):
        base = package[: len(package) - node.level + 1] if node.level else ()
        stem = ".".join([*base, *([node.module] if node.module else [])])
        for alias in node.names:
            # `from package import name`: the name may itself be a module.
            deeper = f"{stem}.{alias.name}"
            target = deeper if deeper in files(stem.split(".")[0]) else stem
            yield Import(target, late, typing)
    late = late or isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
    for child in ast.iter_child_nodes(node):
        if isinstance(child, STATEMENTS):
            yield from _walk(child, package, late=late, typing=typing)


STATEMENTS = (ast.stmt, ast.ExceptHandler, ast.match_case)
"""What an import can be, or can be in."""


def _is_for_types(test: ast.expr) -> bool:
    return any(
        getattr(node, "id", getattr(node, "attr", "")) == "TYPE_CHECKING" for node in ast.walk(test)
    )


def unit(module: str) -> str:
    """The room of a module, a file or folder directly below its package; "" for the package."""
    return [*module.split("."), ""][1]


@cache
def package_imports(package: str, *, run: bool = False) -> dict[str, set[str]]:
    """Module -> modules of its own package that it imports; `run`: only as it is imported."""
    modules = files(package)
    return {
        name: {
            entry.target
            for entry in imports(path)
            if entry.target in modules
            and entry.target != name
            and not (run and (entry.late or entry.typing))
        }
        for name, path in modules.items()
    }
