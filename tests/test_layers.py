"""The layers of docs/architecture.md, held by reading every import of the project."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.project_imports import ADDON, ENGINE, ROOT, files, imports, package_imports, unit

# A package of the engine imports packages above it in this list, never one below. A new one needs
# a place here and in architecture.md.
PACKAGES = (
    "errors",
    "formats",
    "requests",
    "machine",
    "context",
    "model",
    "kernels",
    "photos",
    "colmap",
    "reconstruction",
    "selection",
    "guidance",
    "gpu",
    "cuda",
    "rasterize",
    "exchange",
    "training",
    "masking",
    "evaluation",
    "levels",
    "surface",
    "lighting",
    "run",
    "storage",
    "batch",
    "app",
    "commands",
    "cli",
    "__main__",
)
# Modules of the engine that the add-on may import: no others.
SHARED = ("errors", "formats", "requests")
# Entries that must work, up to their first use of anything else, without torch.
TORCH_FREE = (
    *(
        "",
        "cli",
        "colmap",
        "context",
        "formats",
        "requests",
        "kernels.build",
        "kernels.library",
        "photos",
    ),
    *("guidance", "reconstruction", "run.config", "run.presets", "selection"),
)
# Modules that may import pycolmap.
PYCOLMAP = {"colmap.library"}
# Modules that may write to the terminal: the command line, and the build script of setup.py.
PRINTING = {"commands", "cli", "kernels.build"}
IMPORT_NAMES = {
    "flip-evaluator": "flip_evaluator",
    "opencv-python-headless": "cv2",
    "pillow": "PIL",
    "pillow-heif": "pillow_heif",
    "scikit-learn": "sklearn",
}


def outside(path: Path) -> set[str]:
    """Top-level names of what a file imports when it runs."""
    return {entry.target.split(".")[0] for entry in imports(path) if not entry.typing}


def test_every_file_has_a_package() -> None:
    there = {unit(module) for module in files(ENGINE)} - {""}
    assert there == set(PACKAGES)
    flat = list((ROOT / ENGINE).glob("*.py"))
    assert len(flat) <= 12


def test_imports_go_to_the_same_package_or_one_above() -> None:
    rank = {name: depth for depth, name in enumerate(PACKAGES)}
    wrong = [
        f"{module} -> {target}"
        for module, targets in package_imports(ENGINE).items()
        for target in targets
        if unit(module) and unit(target) and rank[unit(target)] > rank[unit(module)]
    ]
    assert not wrong


@pytest.mark.parametrize("package", [ENGINE, ADDON])
def test_no_circles(package: str) -> None:
    """Counted are imports inside functions and for the type checker, too."""
    graph = {
        module: {t for t in targets if t != package and not module.startswith(f"{t}.")}
        for module, targets in package_imports(package).items()
        if module != package
    }
    while graph:
        leaves = {module for module, targets in graph.items() if not targets & graph.keys()}
        assert leaves, f"these import one another: {sorted(graph)}"
        graph = {module: targets for module, targets in graph.items() if module not in leaves}


@pytest.mark.parametrize("entry", TORCH_FREE)
def test_everything_before_training_needs_no_torch(entry: str) -> None:
    graph = package_imports(ENGINE, run=True)
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
        early = {
            e.target.split(".")[0]
            for e in imports(files(ENGINE)[module])
            if not e.late and not e.typing
        }
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


def test_the_addon_knows_nothing_of_the_engine_but_its_formats() -> None:
    forbidden = {"torch", "pycolmap", "sklearn", "scipy"}
    for name, path in {**files(ADDON), "__init__": ROOT / "__init__.py"}.items():
        assert not outside(path) & forbidden, name
        of_engine = {e.target for e in imports(path) if e.target.split(".")[0] == ENGINE}
        assert name == f"{ADDON}.shared" or not of_engine, name
        assert {unit(target) for target in of_engine} <= set(SHARED), name


def test_formats_need_numpy_alone() -> None:
    for name, path in files(ENGINE).items():
        if unit(name) in SHARED:
            foreign = outside(path) - set(sys.stdlib_module_names) - {ENGINE}
            assert foreign <= {"numpy"}, name


def test_pycolmap_is_imported_in_one_place() -> None:
    users = {
        name.removeprefix(f"{ENGINE}.")
        for name, path in files(ENGINE).items()
        if "pycolmap" in outside(path)
    }
    assert users == PYCOLMAP


def test_ray_is_imported_when_it_is_used() -> None:
    for name, path in files(ENGINE).items():
        used = [entry for entry in imports(path) if entry.target.split(".")[0] == "ray"]
        assert all(entry.late for entry in used), name
        assert not used or name.startswith(f"{ENGINE}.batch.ray_"), name


@pytest.mark.parametrize("package", [ENGINE, ADDON])
def test_nothing_imports_what_is_not_shipped(package: str) -> None:
    for name, path in files(package).items():
        assert not outside(path) & {"tests", "benchmarks", "demo", "tools", "pytest"}, name


def test_only_the_command_line_prints() -> None:
    for name, path in files(ENGINE).items():
        short = name.removeprefix(f"{ENGINE}.")
        if short in PRINTING or unit(name) in PRINTING:
            continue
        text = path.read_text(encoding="utf-8")
        if not any(word in text for word in ("print(", "exit(", "input(", "sys.std")):
            continue
        for node in ast.walk(ast.parse(text)):
            called = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
            assert called not in ("print", "sys.stdout.write", "sys.stderr.write"), name
            assert called not in ("sys.exit", "exit", "input"), name


def declared_packages() -> set[str]:
    """Import names of all that the engine may import."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    used = ("train", "cluster", "store", "flip", "video", "heic", "masks", "gpu")
    asked = [*project["dependencies"], *(name for extra in used for name in extras[extra])]
    names = [re.match(r"[\w.-]+", requirement) for requirement in asked]
    declared = {match[0].lower() for match in names if match}
    return {IMPORT_NAMES.get(name, name) for name in declared}


def test_what_is_imported_is_declared() -> None:
    importable = declared_packages()
    for name, path in files(ENGINE).items():
        foreign = outside(path) - set(sys.stdlib_module_names) - {ENGINE, "ziglang"}
        assert foreign <= importable, f"{name} imports {sorted(foreign - importable)}"


def test_the_addons_tests_load_where_numpy_alone_is_installed() -> None:
    missing = sorted(declared_packages() - {"numpy"})
    # None: an import of it fails, as in Blender's Python
    code = f"import sys; sys.modules.update(dict.fromkeys({missing!r})); import pytest; "
    code += (
        "sys.exit(pytest.main(['--collect-only', '-qq', '-p', 'no:cacheprovider', *sys.argv[1:]]))"
    )
    command = [sys.executable, "-c", code, "tests/addon"]
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stdout[-2000:]


def test_one_version_number() -> None:
    import roigs_engine

    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    assert manifest["version"] == roigs_engine.__version__
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert "version" in project["project"].get("dynamic", [])
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"## [{roigs_engine.__version__}]" in changelog


def test_tests_share_modules_not_one_another() -> None:
    """Code used by several tests is in its own module, whose name is no `test_*`."""
    statement = re.compile(
        r"^ *(?:from +(?:tests\b|\.)[\w.]* +import +(?:\([^)]*\)|.*)|import +tests\b.*)",
        re.MULTILINE,
    )
    for path in sorted((ROOT / "tests").rglob("*.py")):
        found = statement.findall(path.read_text(encoding="utf-8"))
        assert not [line for line in found if re.search(r"\btest_", line)], path
