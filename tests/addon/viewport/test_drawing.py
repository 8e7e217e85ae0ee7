"""The viewport's splats in a Blender, by the scripts in tests/blender.

`ROIGS_BLENDER` names the Blenders: executables `blender`, or Pythons that have `bpy`, separated by
the system's path separator. Without it, this Python is used when it has `bpy`.
"""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.formats.targets import CYCLES, EEVEE, PLAIN, VIEWERS
from tests.addon.pictures import load_png
from tests.addon.scenes import ROOT
from tests.addon.splat_cases import fine_ply, random_arrays, random_ply
from tests.poses import look_at

pytestmark = pytest.mark.blender

BLENDERS = [name for name in os.environ.get("ROIGS_BLENDER", "").split(os.pathsep) if name]
if not BLENDERS and importlib.util.find_spec("bpy"):
    BLENDERS = [__import__("bpy").app.binary_path or sys.executable]


@pytest.fixture(params=BLENDERS or ["none"])
def blender(request: pytest.FixtureRequest) -> str:
    if not BLENDERS:
        pytest.skip("no bpy here and no ROIGS_BLENDER")
    return str(request.param)


def run(blender: str, script: str, *folders: Path) -> str:
    """Output of a script of tests/blender for folders; fails when the script does."""
    command = [blender, str(ROOT / "tests" / "blender" / script), *map(str, folders)]
    if "python" not in Path(blender).name:
        command = [blender, "-b", "--factory-startup", "--python-exit-code", "1"]
        command += ["--python", str(ROOT / "tests" / "blender" / script), "--", *map(str, folders)]
    (folders[0] / "resources").mkdir()
    environment = {
        **os.environ,
        "BLENDER_USER_RESOURCES": str(folders[0] / "resources"),
        "LIBGL_ALWAYS_SOFTWARE": "1",
        "PYTHONUNBUFFERED": "1",
    }
    if blender != sys.executable:  # this one may have found `bpy` by it
        environment.pop("PYTHONPATH", None)
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    return done.stdout


def cameras() -> list[dict]:
    """Square and oblong, off-centre, with fx ≠ fy, from outside and from among the Gaussians."""
    shapes = [
        ("outside", 160, 112, 170.0, 170.0, 80.0, 56.0, (2.2, -1.0, 0.7)),
        ("shifted", 112, 160, 150.0, 120.0, 90.5, 50.25, (-1.0, 2.0, 1.2)),
        ("inside", 160, 160, 90.0, 100.0, 70.0, 95.0, (0.3, 0.2, -0.2)),
    ]
    names = ("name", "width", "height", "fx", "fy", "cx", "cy")
    return [
        {
            **dict(zip(names, shape[:7], strict=True)),
            "world_to_camera": look_at(shape[7], up=(0.0, 0.1, 1.0)).tolist(),
        }
        for shape in shapes
    ]


def degrees(coefficients: int) -> dict[str, np.ndarray]:
    """Gaussians with as many coefficients.

    Some have opacities of exactly 1 and 0, and some are flat, as programs write them.
    """
    arrays = random_arrays(800, 5, coefficients)
    arrays["logit_opacities"][:200], arrays["logit_opacities"][200:250] = np.inf, -np.inf
    arrays["log_scales"][100:300, 0] = -np.inf
    return arrays


def at_the_edges(camera: dict) -> dict[str, np.ndarray]:
    """Needles just before a camera's plane and far beside its picture; balls around the camera.

    Large ones a little beside the picture, and the ball that ends before the camera, must look as
    in the engine's picture in any window.
    """
    arrays = random_arrays(700, seed=6)
    to_world = np.linalg.inv(camera["world_to_camera"])
    beside = [[1.0, 0.2, 0.05], [-1.0, 0.4, 0.03], [0.1, 2.0, 0.1], [1.5, 0.1, 0.4], [0, -1, 0.3]]
    arrays["means"][:5] = np.array(beside) @ to_world[:3, :3].T + to_world[:3, 3]
    arrays["log_scales"][:5] = np.log([0.27, 0.27, 3.5])
    arrays["logit_opacities"][:5] = 3.0
    around = [[0.1, 0.1, 0.55], [-0.2, 0.0, 0.59], [0.2, -0.1, 0.61]]  # two of them are left out
    arrays["means"][5:8] = np.array(around) @ to_world[:3, :3].T + to_world[:3, 3]
    arrays["log_scales"][5:8] = np.log(0.3)
    arrays["logit_opacities"][5:8] = 0.0
    return arrays


def test_the_viewport_draws_what_the_engine_draws_and_leaves_out_what_it_does(
    blender: str, tmp_path: Path
) -> None:
    """With colours of each degree; in one process, as a Blender takes a second to start."""
    pytest.importorskip("torch")
    from roigs_engine.formats.splat_ply import write_ply
    from roigs_engine.model.gaussians import Gaussians
    from roigs_engine.rasterize.camera_path import load_camera_path
    from roigs_engine.rasterize.image_files import render_sequence

    outside, shifted, inside = cameras()
    cases = {str(number): (degrees(number), [outside]) for number in (1, 4, 9)}
    cases["16"] = degrees(16), [outside, shifted, inside]
    cases["edges"] = at_the_edges(inside), [inside]
    pictures = 0
    for name, (arrays, chosen) in cases.items():
        folder = tmp_path / name
        folder.mkdir()
        write_ply(folder / "splats.ply", arrays)
        (folder / "cameras.json").write_text(json.dumps({"cameras": chosen}), encoding="utf-8")
        gaussians = Gaussians.load_ply(folder / "splats.ply")
        render_sequence(gaussians, load_camera_path(folder / "cameras.json"), folder)
        pictures += len(chosen)
    folders = [tmp_path / name for name in cases]
    assert len(run(blender, "viewport_parity.py", *folders).splitlines()) >= 8 * pictures


def engine_picture(folder: Path, camera: dict, *plain: str) -> np.ndarray:
    """(H, W, 3) uint8 that the engine makes of all PLYs of a folder in one picture.

    Those named are drawn as for plain viewers, whatever they say.
    """
    from roigs_engine.model.gaussians import Gaussians
    from roigs_engine.model.scene import Camera
    from roigs_engine.rasterize.image_files import to_uint8
    from roigs_engine.rasterize.instances import Instance, render_instances

    models = []
    for path in sorted(folder.glob("splats*.ply")):
        gaussians, frame = Gaussians.load_framed(path)
        if path.stem in plain:
            gaussians = replace(gaussians, target=PLAIN)
        models.append(Instance(gaussians=gaussians, frame=frame, matrix=np.eye(4)))
    names = ("width", "height", "fx", "fy", "cx", "cy")
    lens = Camera(**{name: camera[name] for name in names})
    layer = render_instances(models, lens, np.array(camera["world_to_camera"]))
    return to_uint8(layer.image * layer.alpha[..., None])


def test_the_viewport_draws_as_objects_are_made_for(blender: str, tmp_path: Path) -> None:
    """One object of a kind, and two kinds among each other, in the light of most Gaussians."""
    pytest.importorskip("torch")
    from roigs_engine.rasterize.image_files import save_png

    outside, shifted, inside = cameras()
    cases = (
        ((VIEWERS,), [outside]),
        ((VIEWERS, PLAIN), [outside, shifted, inside]),
        ((CYCLES,), [shifted]),
        ((EEVEE, EEVEE, VIEWERS), [inside]),
    )
    folders, pictures = [], 0
    for kinds, chosen in cases:
        folder = tmp_path / "-".join(kind.name for kind in kinds)
        folder.mkdir()
        folders.append(folder)
        names = [f"splats-{seed}" for seed in range(len(kinds))]
        for seed, (name, kind) in enumerate(zip(names, kinds, strict=True)):
            fine_ply(folder / f"{name}.ply", 800 // len(kinds), seed, target=kind)
        (folder / "cameras.json").write_text(json.dumps({"cameras": chosen}), encoding="utf-8")
        for camera in chosen:
            wanted = engine_picture(folder, camera)
            without = engine_picture(folder, camera, *names)
            error = np.square((wanted.astype(float) - without) / 255).mean()
            assert -10 * np.log10(error) < 33, "no difference: nothing would be compared"
            save_png(folder / f"{camera['name']}.png", wanted)
        pictures += len(chosen)
    assert len(run(blender, "viewport_parity.py", *folders).splitlines()) >= 8 * pictures


def test_the_viewport_draws_other_sizes_than_the_photos_as_the_engine(
    blender: str, tmp_path: Path
) -> None:
    """Of models whose photos have half and twice the pixels."""
    pytest.importorskip("torch")
    from roigs_engine.model.gaussians import Gaussians
    from roigs_engine.rasterize.camera_path import load_camera_path
    from roigs_engine.rasterize.image_files import render_sequence

    outside = cameras()[0]
    folders = []
    for kind in (VIEWERS, PLAIN):
        for factor in (0.5, 2.0):
            folder = tmp_path / f"{kind.name}-{factor}"
            folder.mkdir()
            folders.append(folder)
            focal = factor * outside["fx"]
            fine_ply(folder / "splats.ply", 800, target=kind, photo_focal=focal)
            (folder / "cameras.json").write_text(json.dumps({"cameras": [outside]}))
            model = Gaussians.load_ply(folder / "splats.ply")
            path, image = load_camera_path(folder / "cameras.json"), f"{outside['name']}.png"
            render_sequence(replace(model, photo_focal=None), path, tmp_path)
            render_sequence(model, path, folder)
            apart = [load_png(place / image) for place in (tmp_path, folder)]
            assert np.square(apart[0] - apart[1]).mean() > 1e-4, "nothing would be compared"
    run(blender, "viewport_parity.py", *folders)


def test_the_viewport_draws_the_demo(blender: str, tmp_path: Path) -> None:
    """The composition of `make demo`, or of the run folder that `ROIGS_DEMO_RUN` names."""
    pytest.importorskip("torch")
    result = Path(os.environ.get("ROIGS_DEMO_RUN", ROOT / "runs" / "demo")) / "result.ply"
    if not result.is_file():
        pytest.skip("the demo has not been trained")
    from roigs_engine import load_colmap
    from roigs_engine.model.gaussians import Gaussians
    from roigs_engine.rasterize.camera_path import load_camera_path
    from roigs_engine.rasterize.image_files import render_sequence

    (tmp_path / "splats.ply").symlink_to(result.resolve())
    chosen = []
    for image in load_colmap(ROOT / "demo" / "scene").images[::60]:
        camera, shrink = image.camera, 160 / image.camera.width
        width, height = 160, round(camera.height * shrink)
        chosen.append(
            {
                "name": image.name.replace("/", " "),
                "width": width,
                "height": height,
                "fx": camera.fx * shrink,
                "fy": camera.fy * shrink,
                "cx": camera.cx * shrink,
                "cy": camera.cy * shrink,
                "world_to_camera": image.world_to_camera.tolist(),
            }
        )
    (tmp_path / "cameras.json").write_text(json.dumps({"cameras": chosen}), encoding="utf-8")
    gaussians = Gaussians.load_ply(result)
    render_sequence(gaussians, load_camera_path(tmp_path / "cameras.json"), tmp_path)
    run(blender, "viewport_parity.py", tmp_path)


@pytest.mark.parametrize("script", ["viewport_checks.py", "level_checks.py"])
def test_the_viewport_draws_objects_as_they_lie(blender: str, tmp_path: Path, script: str) -> None:
    random_ply(tmp_path / "a.ply", 600, seed=1)
    random_ply(tmp_path / "b.ply", 400, seed=2, coefficients=4)
    run(blender, script, tmp_path)
