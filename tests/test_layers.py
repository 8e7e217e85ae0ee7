"""The layers of docs/architecture.md, held by reading every import of the project."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
ENGINE, ADDON = "roigs_engine", "roigs_addon"

# A file of the engine imports files of its own layer or of one above in this list, never of one
# below. A folder stands for all its files. A new file needs a place here and in architecture.md.
LAYERS: dict[str, tuple[str, ...]] = {
    "base": ("errors", "events", "files", "lock", "older", "kernels"),
    "values": ("scene", "roi", "ply", "gaussians", "sampling", "scores"),
    "parts": (
        *(
            "photo_files",
            "photo_headers",
            "images",
            "colmap_files",
            "undistort",
            "colmap_photos",
            "colmap",
        ),
        *("inspect", "export", "selection", "split", "config"),
        *("cuda", "rasterize", "losses", "optimizer", "metrics", "render"),
        *("averaging", "breaks", "densify", "floaters", "capacity", "spacing", "region"),
        *("checkpoint", "health", "memory", "scene_warnings"),
        *("compose", "report"),
    ),
    "jobs": ("trainer", "stages", "evaluate", "crops"),
    "run": ("request", "pipeline", "strategies", "sessions"),
    "command line": ("commands", "cli", "__main__"),
}
# Entries that must work, up to their first use of anything else, without torch.
TORCH_FREE = ("", "cli", "colmap", "config", "export", "inspect", "kernels", "selection", "split")
# Where pycolmap may be imported: the one place that needs it.
PYCOLMAP = {"undistort"}
# What may write to the terminal: the command line, and the build script that setup.py runs.
PRINTING = {"commands", "cli", "kernels.build"}
IMPORT_NAMES = {"scikit-learn": "sklearn", "pillow": "PIL"}


@dataclass(frozen=True)
class Import:
    """`target` as a dotted name; `late`: inside a function, run when that is called."""

    target: str
    late: bool


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
    """Everything a file imports but for `if TYPE_CHECKING:`, relative names resolved."""
    package = path.relative_to(ROOT).parts[:-1]
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return tuple(_walk(tree, package, late=False))


def _walk(node: ast.AST, package: tuple[str, ...], *, late: bool) -> Iterator[Import]:
    if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
        for child in node.orelse:
            yield from _walk(child, package, late=late)
        return
    if isinstance(node, ast.Import):
        yield from (Import(alias.name, late) for alias in node.names)
    if isinstance(node, ast.ImportFrom):
        base = package[: len(package) - node.level + 1] if node.level else ()
        stem = ".".join([*base, *([node.module] if node.module else [])])
        for alias in node.names:
            # `from package import name`: the name may itself be a module.
            deeper = f"{stem}.{alias.name}"
            yield Import(deeper if deeper in files(stem.split(".")[0]) else stem, late)
    late = late or isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda))
    for child in ast.iter_child_nodes(node):
        yield from _walk(child, package, late=late)


def unit(module: str) -> str:
    """The file or folder directly below the engine that a module belongs to; "" for itself."""
    return [*module.split("."), ""][1]


def engine_imports(*, late: bool = True) -> dict[str, set[str]]:
    """Module -> modules of the engine that it imports."""
    modules = files(ENGINE)
    return {
        name: {
            entry.target
            for entry in imports(path)
            if entry.target in modules and entry.target != name and (late or not entry.late)
        }
        for name, path in modules.items()
    }


def outside(path: Path) -> set[str]:
    """Top-level names of what a file imports."""
    return {entry.target.split(".")[0] for entry in imports(path)}


def test_every_file_has_a_layer() -> None:
    placed = [name for names in LAYERS.values() for name in names]
    there = {unit(module) for module in files(ENGINE)} - {""}
    assert len(placed) == len(set(placed))
    assert there == set(placed)


def test_imports_go_to_the_same_or_a_lower_layer() -> None:
    rank = {name: depth for depth, names in enumerate(LAYERS.values()) for name in names}
    wrong = [
        f"{module} -> {target}"
        for module, targets in engine_imports().items()
        for target in targets
        if unit(module) and unit(target) and rank[unit(target)] > rank[unit(module)]
    ]
    assert not wrong


def test_no_circles() -> None:
    graph = {
        module: {t for t in targets if t != ENGINE and not module.startswith(f"{t}.")}
        for module, targets in engine_imports(late=False).items()
        if module != ENGINE
    }
    while graph:
        leaves = {module for module, targets in graph.items() if not targets & graph.keys()}
        assert leaves, f"these import one another: {sorted(graph)}"
        graph = {module: targets for module, targets in graph.items() if module not in leaves}


@pytest.mark.parametrize("entry", TORCH_FREE)
def test_everything_before_training_needs_no_torch(entry: str) -> None:
    graph = engine_imports(late=False)
    start = f"{ENGINE}.{entry}" if entry else ENGINE
    todo = [module for module in graph if f"{module}.".startswith(f"{start}.") or module == start]
    if not entry:
        todo = [ENGINE]
    seen: set[str] = set()
    while todo:
        module = todo.pop()
        if module in seen:
            continue
        seen.add(module)
        todo += graph[module]
        early = {e.target.split(".")[0] for e in imports(files(ENGINE)[module]) if not e.late}
        assert "torch" not in early, f"{entry or ENGINE} imports torch through {module}"


def test_public_names_exist_and_come_when_used() -> None:
    code = (
        "import sys, roigs_engine as r\n"
        "assert set(r.__all__) <= set(dir(r))\n"
        "from roigs_engine import Camera, OrientedBox, SelectionConfig, TrainConfig\n"
        "from roigs_engine import load_colmap, load_rois, select_cameras, choose_test_views\n"
        "assert 'torch' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
    import roigs_engine

    for name in roigs_engine.__all__:
        assert getattr(roigs_engine, name).__name__ == name
    with pytest.raises(AttributeError, match="nothing"):
        _ = roigs_engine.nothing


def test_the_engine_knows_nothing_of_blender() -> None:
    for name, path in files(ENGINE).items():
        assert not outside(path) & {"bpy", "mathutils", "gpu", ADDON}, name


def test_the_addon_knows_nothing_of_the_engines_code() -> None:
    forbidden = {"torch", "pycolmap", "sklearn", "scipy", ENGINE}
    for name, path in {**files(ADDON), "__init__": ROOT / "__init__.py"}.items():
        assert not outside(path) & forbidden, name


def test_pycolmap_stays_where_photos_are_undistorted() -> None:
    users = {unit(n) for n, path in files(ENGINE).items() if "pycolmap" in outside(path)}
    assert users == PYCOLMAP


@pytest.mark.parametrize("package", [ENGINE, ADDON])
def test_nothing_imports_what_is_not_shipped(package: str) -> None:
    for name, path in files(package).items():
        assert not outside(path) & {"tests", "benchmarks", "demo", "tools", "pytest"}, name


def test_only_the_command_line_prints() -> None:
    for name, path in files(ENGINE).items():
        short = name.removeprefix(f"{ENGINE}.")
        if short in PRINTING or unit(name) in PRINTING:
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            called = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
            assert called not in ("print", "sys.stdout.write", "sys.stderr.write"), name
            assert called not in ("sys.exit", "exit", "input"), name


def test_what_is_imported_is_declared() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    asked = [*project["dependencies"], *extras["train"], *extras["cuda"]]
    names = [re.match(r"[\w.-]+", requirement) for requirement in asked]
    declared = {match[0].lower() for match in names if match}
    importable = {IMPORT_NAMES.get(name, name) for name in declared}
    for name, path in files(ENGINE).items():
        foreign = outside(path) - set(sys.stdlib_module_names) - {ENGINE, "ziglang"}
        assert foreign <= importable, f"{name} imports {sorted(foreign - importable)}"


def test_one_version_number() -> None:
    import roigs_engine

    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    assert manifest["version"] == roigs_engine.__version__
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert "version" in project["project"].get("dynamic", [])
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"## [{roigs_engine.__version__}]" in changelog
