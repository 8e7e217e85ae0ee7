"""The layers of the add-on: each package imports only from those above it."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import roigs_addon

PACKAGE = Path(roigs_addon.__path__[0])
PACKAGES = (
    {"errors", "shared", "worker"},
    {"geometry"},
    {"engine"},
    {"blender", "stage_properties"},
    {"properties"},
    {"settings", "windows"},
    {"scene"},
    {"jobs"},
    {"facts", "rendering", "viewport"},
    {"operators"},
    {"ui"},
)
"""Packages and single files, from the top. Those in one line do not import one another."""
RANK = {name: rank for rank, names in enumerate(PACKAGES) for name in names}
MODULES = {
    ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__"): path
    for path in PACKAGE.rglob("*.py")
    if "examples" not in path.parts and path != PACKAGE / "__init__.py"
}


def imports(module: str) -> Iterator[str]:
    """Modules of the add-on that a module imports, also those for types only."""
    path = MODULES[module]
    package = path.relative_to(PACKAGE).parts[:-1]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.ImportFrom) or not 0 < node.level <= len(package) + 1:
            continue  # of other packages, or above the add-on: the engine, in `shared`
        stem = [*package[: len(package) - node.level + 1], *filter(None, [node.module])]
        for alias in node.names:
            deeper = ".".join([*stem, alias.name])
            yield deeper if deeper in MODULES else ".".join(stem)


def test_every_module_is_in_a_package() -> None:
    assert {module.partition(".")[0] for module in MODULES} == set(RANK)


def test_packages_import_from_those_above() -> None:
    wrong = [
        f"{module} -> {target}"
        for module in MODULES
        for target in imports(module)
        if (here := module.partition(".")[0]) != (there := target.partition(".")[0])
        and RANK[there] >= RANK[here]
    ]
    assert not wrong


def test_nothing_is_circular() -> None:
    graph = {module: set(imports(module)) for module in MODULES}
    for module, targets in graph.items():  # the files of a package may use the package itself
        targets -= {target for target in targets if module.startswith(f"{target}.")}
    while graph:
        leaves = {module for module, targets in graph.items() if not targets & graph.keys()}
        assert leaves, f"these import one another: {sorted(graph)}"
        graph = {module: targets for module, targets in graph.items() if module not in leaves}
