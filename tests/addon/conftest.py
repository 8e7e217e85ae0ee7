"""Fixtures of the add-on's tests.

Tests that use `addon` need a Blender: its `bpy` module, or the program itself
(tests/blender/run.py). Where there is none they are skipped, with the reason.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from roigs_addon.engine.command import Engine
from roigs_engine.formats.run_files import BACKGROUND
from tests import warm_engine
from tests.addon.colmap_project import write_project
from tests.addon.photo_cases import SIDE
from tests.addon.scenes import ready

# Before bpy is imported: the user's own settings are neither read nor written.
RESOURCES = Path(tempfile.mkdtemp(prefix="roigs-blender-"))
os.environ["BLENDER_USER_RESOURCES"] = str(RESOURCES)

try:
    import bpy

    MISSING = ""
except ImportError as error:
    MISSING = f"no Blender here: {error}"


def pytest_sessionfinish() -> None:
    shutil.rmtree(RESOURCES, ignore_errors=True)


def pytest_report_header() -> str:
    return MISSING or f"Blender {bpy.app.version_string}"


@pytest.fixture
def blender() -> ModuleType:
    """`bpy` with an empty file; the add-on is not registered."""
    if MISSING:
        pytest.skip(MISSING)
    if bpy.context.preferences.is_dirty:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.context.preferences.is_dirty = False
        return bpy
    # A third of the time. The folder of temporary files would stay as it is.
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    for path in Path(bpy.app.tempdir).iterdir():
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    return bpy


@pytest.fixture
def addon(blender: ModuleType) -> Iterator[ModuleType]:
    """The registered add-on. Anything that stays registered would make bpy 4.5 hang at exit."""
    import roigs_addon

    roigs_addon.register()
    yield roigs_addon
    roigs_addon.unregister()


@pytest.fixture(autouse=True)
def warm(request: pytest.FixtureRequest) -> Iterator[None]:
    """Engine commands start at once, but not those of tests marked `cold`."""
    with pytest.MonkeyPatch.context() as patch:
        if request.node.get_closest_marker("cold") is None:
            patch.setattr(Engine, "command", warm_engine.quick(Engine.command))
        yield


@pytest.fixture(autouse=True)
def exact_look(request: pytest.FixtureRequest) -> Iterator[None]:
    """Tests of the add-on's own drawing, marked so, see a Blender without splats of its own."""
    with pytest.MonkeyPatch.context() as patch:
        if not MISSING and request.node.get_closest_marker("exact_look"):
            from roigs_addon.scene import native_splats

            patch.setattr(native_splats, "exist", lambda: False)
        yield


@pytest.fixture
def engine(addon: ModuleType) -> object:
    """An engine that can train; skips without one."""
    from roigs_addon import settings
    from roigs_addon.engine.python import FOR_TRAINING
    from roigs_addon.errors import AddonError

    try:
        return settings.engine(FOR_TRAINING)
    except AddonError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small COLMAP project with photos."""
    return write_project(tmp_path_factory.mktemp("colmap") / "ein Garten 庭")


@pytest.fixture
def run(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> tuple[object, Path]:
    """A scene and its run folder with made-up results."""
    from tests.addon.splat_cases import random_ply

    folder = tmp_path / "run"
    for number, name in enumerate(("result", Path(BACKGROUND).stem, "rois/thing", "coarse/thing")):
        path = folder / f"{name}.ply"
        path.parent.mkdir(parents=True, exist_ok=True)
        random_ply(path, 40 + number, seed=number)
    return ready(blender, project, folder), folder


@pytest.fixture
def two(blender: ModuleType, run):
    """The last result, which is shown, and an earlier one."""
    from roigs_engine.formats.splat_ply import read_ply
    from tests.addon.results import PARTS, set_aside
    from tests.addon.splat_cases import random_ply

    scene, folder = run
    older = set_aside(folder)
    for part in PARTS:
        copy = shutil.copytree if (older / part).is_dir() else shutil.copy
        copy(older / part, folder / part)
    for seed, path in enumerate(sorted(older.rglob("*.ply"))):  # as many, but other Gaussians
        random_ply(path, len(read_ply(path)["means"]), seed=70 + seed)
    blender.ops.roigs.load_results()
    return scene, folder, older


@pytest.fixture
def reconstructing(addon: ModuleType, blender: ModuleType, monkeypatch: pytest.MonkeyPatch):
    """The scene, with small photos; skips where no engine can reconstruct."""
    from roigs_addon import settings
    from roigs_addon.engine.python import FOR_RECONSTRUCTING
    from roigs_addon.errors import AddonError

    try:
        settings.engine(FOR_RECONSTRUCTING)
    except AddonError as error:
        pytest.skip(str(error))
    scene = blender.context.scene
    scene.roigs.feature_side = SIDE
    monkeypatch.setenv(warm_engine.IMPORTED_FIRST, "tests.engine.reconstruction.forked_worker")
    return scene
