"""`make extension`: the zip, and a repository that a Blender can install from."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from roigs_engine.formats.splat_ply import write_ply

ROOT = Path(__file__).resolve().parents[2]


def load(name: str, folder: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, ROOT / folder / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that `make extension` makes; it held an earlier version."""
    sys.path.insert(0, str(ROOT / "tools"))
    try:
        script = load("build_extension", "tools")
        module = load("blender_module", "tools")
    finally:
        sys.path.pop(0)
    blender = os.environ.get("ROIGS_BLENDER")
    if not blender and module.own_version() != module.VERSION:
        pytest.skip("neither bpy nor a Blender here")
    out = tmp_path_factory.mktemp("repository") / "dist"
    out.mkdir()
    (out / "roigs-0.0.1.zip").write_bytes(b"an earlier version")
    assert script.build(script.builder(blender), out) == 0
    return out


def test_the_folder_is_a_repository_of_one_version(built: Path) -> None:
    (archive,) = built.glob("*.zip")
    (listed,) = json.loads((built / "index.json").read_text(encoding="utf-8"))["data"]
    assert listed["id"] == "roigs" and listed["archive_url"] == f"./{archive.name}"
    assert listed["archive_hash"] == f"sha256:{hashlib.sha256(archive.read_bytes()).hexdigest()}"
    assert f"{archive.name}?repository=" in (built / "index.html").read_text(encoding="utf-8")


def test_the_check_of_a_release_knows_the_listing(built: Path) -> None:
    checks = load("check_dist", ".github/scripts")
    checks.check_listing(built / "index.json")
    (archive,) = built.glob("*.zip")
    content = archive.read_bytes()
    archive.write_bytes(content + b"other")
    try:
        with pytest.raises(checks.CheckError, match="not the one that it names"):
            checks.check_listing(built / "index.json")
    finally:
        archive.write_bytes(content)


def test_the_engine_of_the_zip_makes_web_pages(built: Path, tmp_path: Path) -> None:
    """The add-on starts the engine from its own folder, with the Python of an environment."""
    for package in ("torch", "gsply"):
        pytest.importorskip(package)
    (archive,) = built.glob("*.zip")
    with zipfile.ZipFile(archive) as packed:
        packed.extractall(tmp_path / "roigs")
    source = tmp_path / "a.ply"
    write_ply(source, small_model())
    command = [sys.executable, "-m", "roigs_engine", "convert", str(source)]
    out = tmp_path / "a.html"
    subprocess.run([*command, str(out)], cwd=tmp_path / "roigs", check=True, timeout=120)
    assert "class Renderer" in out.read_text(encoding="utf-8")


def small_model() -> dict[str, np.ndarray]:
    """Ten Gaussians."""
    random = np.random.default_rng(0)
    shapes = {"means": (3,), "quats": (4,), "log_scales": (3,), "logit_opacities": (), "sh": (1, 3)}
    return {name: random.normal(size=(10, *shape)).astype("f4") for name, shape in shapes.items()}


@pytest.mark.skipif("ROIGS_BLENDER" not in os.environ, reason="needs the program blender")
def test_a_blender_installs_from_it(built: Path, tmp_path: Path) -> None:
    blender = [os.environ["ROIGS_BLENDER"], "--online-mode", "--command", "extension"]
    variables = os.environ | {"BLENDER_USER_RESOURCES": str(tmp_path)}
    for arguments in (
        ["repo-add", "page", "--name", "Page", "--url", (built / "index.json").as_uri()],
        ["sync"],
        ["install", "--enable", "roigs"],
    ):
        subprocess.run([*blender, *arguments], env=variables, check=True, timeout=120)
    assert (tmp_path / "extensions" / "page" / "roigs" / "roigs_addon" / "__init__.py").is_file()
