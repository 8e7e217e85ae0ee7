"""`surface`: meshes of a run's boxes."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest
import torch
from PIL import Image
from scipy.spatial.transform import Rotation

from roigs_engine.app.surface import _inputs, make_surfaces
from roigs_engine.app.surface_record import add_to_reports, put_section
from roigs_engine.cli import main
from roigs_engine.context import Context
from roigs_engine.errors import Stopped
from roigs_engine.formats.rois import rois_document
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import PhotoMask
from roigs_engine.photos.png import PNG
from roigs_engine.requests.runs import MakeSurface
from roigs_engine.run.definition import define_run
from roigs_engine.surface import make
from roigs_engine.surface.make import SurfaceOptions
from tests.engine.ball_runs import BALL, HALF, NAMES, write_run
from tests.engine.commands.command_line import refused
from tests.engine.levels.balls import cloud
from tests.engine.runs import tiny
from tests.engine.synthetic_scene import make_scene, truth

trimesh = pytest.importorskip("trimesh")
pytest.importorskip("skimage")


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return write_run(tmp_path)


def test_a_box_gets_a_mesh_and_its_facts(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["surface", str(run), "--only", "ball", "--device", "cpu", "--faces", "2000"]
    assert main([*words, "--watertight", "--format", "stl"]) == 0
    assert "Box 'ball':" in capsys.readouterr().out
    record = json.loads((run / "rois/ball.surface.json").read_text())
    assert record["watertight"] and record["volume"] > 0
    mesh = trimesh.load(run / "rois/ball.glb", force="mesh")
    assert len(mesh.faces) == record["faces"]
    assert trimesh.load(run / "rois/ball.stl").is_watertight
    first = (run / "rois/ball.glb").read_bytes()
    assert main([*words, "--watertight"]) == 0
    assert (run / "rois/ball.glb").read_bytes() == first


def test_meshes_in_other_formats_and_on_pages(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["surface", str(run), "--device", "cpu", "--faces", "2000", "--format", "stl"]
    assert main(words) == 0
    glb, stl, page = run / "rois/ball.glb", run / "other.stl", run / "page.html"
    assert main(["convert", str(glb), str(stl)]) == 0
    assert stl.read_bytes() == (run / "rois/ball.stl").read_bytes()
    model = str(run / "result.ply")
    assert main(["convert", model, str(page), "--from-up=y", "--mesh", str(glb)]) == 0
    assert '"meshes": 1' in page.read_text() and '"places"' in page.read_text()
    capsys.readouterr()
    assert "which ball.spz cannot contain" in refused(capsys, "convert", glb, run / "ball.spz")
    assert "--plain is for Gaussians" in refused(capsys, "convert", glb, stl, "--plain")
    other = "convert", model, run / "b.spz", "--mesh", glb
    assert "--mesh is for web pages alone" in refused(capsys, *other)


def test_the_boxes_are_those_of_the_training(run: Path) -> None:
    trained = json.loads((run / "boxes.json").read_text())["rois"]
    (run / "manifest.json").write_text(json.dumps({"config": {}, "rois": trained}))
    others = [OrientedBox.between("pot", [-0.5] * 3, [0.0] * 3)]
    (run / "boxes.json").write_text(rois_document(others))
    assert main(["surface", str(run), "--device", "cpu", "--faces", "2000"]) == 0
    assert (run / "rois/ball.glb").is_file() and not (run / "rois/pot.glb").exists()
    (run / "boxes.json").unlink()
    assert main(["surface", str(run), "--device", "cpu", "--faces", "2000"]) == 0


def test_what_cannot_be_is_said_in_a_line(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "There is no box 'vase'" in refused(capsys, "surface", run, "--only", "vase")
    assert "is not a run folder" in refused(capsys, "surface", run.parent)
    (run / "settings.json").unlink()
    assert "has no record of its training photos" in refused(capsys, "surface", run)


def counted_calls(monkeypatch: pytest.MonkeyPatch, stop_at: int = 0) -> list[str]:
    """The boxes whose surfaces are made from now on; the `stop_at`-th is stopped in its middle."""
    calls: list[str] = []
    mesh_of = make.mesh_of

    def stopped(field: Any, roi: OrientedBox, maps: Any, **options: Any) -> Any:
        calls.append(roi.name)
        if len(calls) == stop_at:
            raise Stopped
        return mesh_of(field, roi, maps, **options)

    monkeypatch.setattr(make, "mesh_of", stopped)
    return calls


def test_the_same_mask_on_another_photo_is_another_surface(tmp_path: Path) -> None:
    scene = make_scene(tmp_path, views=4)
    mask = PhotoMask(
        digest="m", path=tmp_path, remake=lambda: None, small=np.full((8, 8), 255, "u1")
    )
    keys, config = set(), replace(tiny("joint"), test_every=0)
    for changed in ({"objects": {"ball": mask}}, {"exposure": 1.0, "digest": "brighter"}):
        for number in range(2):
            images = list(scene.images)
            images[number] = replace(images[number], **changed)
            run = define_run(tmp_path, replace(scene, images=tuple(images)), [BALL], config)
            keys.add(_inputs(truth(), run, BALL, SurfaceOptions()))
    assert len(keys) == 4


def test_a_stopped_command_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write_run(tmp_path, boxes=(HALF, BALL))
    request = MakeSurface(run=folder, device="cpu", faces=2000)
    calls = counted_calls(monkeypatch, stop_at=2)
    with pytest.raises(Stopped):
        make_surfaces(request)
    first = (folder / "rois/half.glb").read_bytes()
    assert not list((folder / "rois").glob("ball*"))
    assert not list((folder / "rois").glob("*tmp*"))
    texts: list[str] = []
    context = Context(emit=lambda event: texts.append(getattr(event, "text", "")))
    assert len(make_surfaces(request, context).surfaces) == 2
    assert calls == ["half", "ball", "ball"]
    assert "Box 'half': its surface already exists." in texts
    assert (folder / "rois/half.glb").read_bytes() == first
    make_surfaces(replace(request, format=("stl",)))  # a file is missing, so both are made again
    assert calls[3:] == ["half", "ball"]
    (folder / "rois/half.glb").write_bytes(b"edited")
    make_surfaces(request)
    assert calls[5:] == ["half"]
    assert (folder / "rois/half.glb").read_bytes() == first
    make_surfaces(replace(request, faces=1000))
    assert calls[6:] == ["half", "ball"]
    as_obj = replace(request, faces=1000, format=("obj",))
    make_surfaces(as_obj)
    (folder / "rois/half.png").unlink()  # the texture of half.obj
    make_surfaces(as_obj)
    assert calls[8:] == ["half", "ball", "half"]
    assert (folder / "rois/half.png").is_file()


def test_masks_decide_what_is_the_object(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Masks of the left half of each photo, though the run was trained without any."""
    folder = write_run(tmp_path)
    words = ["surface", str(folder), "--device", "cpu", "--faces", "2000"]
    assert main(words) == 0
    assert "No masks of the objects in 'ball'" in capsys.readouterr().err
    whole = json.loads((folder / "rois/ball.surface.json").read_text())
    for name in NAMES:
        with Image.open(tmp_path / "scene/images" / name) as photo:
            size = photo.size
        mask = np.zeros(size[::-1], np.uint8)
        mask[: size[1] // 2] = 255
        path = tmp_path / "scene/masks/ball" / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(mask).save(path)
    assert main(words) == 0
    assert "No masks" not in capsys.readouterr().err
    upper = json.loads((folder / "rois/ball.surface.json").read_text())
    assert upper["area"] < 0.8 * whole["area"]


def glass() -> Gaussians:
    """A ball that is seen through, with a smaller one inside."""
    outer, inner = cloud(3000, 0, size=0.4), cloud(500, 1, size=0.1)
    outer.logit_opacities.fill_(-3.0)
    both = zip(outer.tensors().items(), inner.tensors().values(), strict=True)
    return Gaussians(**{name: torch.cat([one, other]) for (name, one), other in both})


def mirror() -> Gaussians:
    """Half a ball, and what a mirror shows behind: a ball out of the box."""
    half = cloud(3000, 0, size=0.4)
    return half.rows(half.means[:, 2] > 0.2)


BAD: dict[str, Callable[[], dict[str, Any]]] = {
    "glass": lambda: {"model": glass()},
    "a mirror": lambda: {"model": mirror()},
    "three photos": lambda: {"photos": 3},
    "millimetres": lambda: {"sim3": pycolmap.Sim3d(1000, pycolmap.Rotation3d(), np.zeros(3))},
    "rotated": lambda: {
        "sim3": pycolmap.Sim3d(
            0.01,
            pycolmap.Rotation3d(Rotation.from_euler("xyz", [40, 70, 20], degrees=True).as_quat()),
            np.array([30.0, -20, 10]),
        )
    },
}


@pytest.mark.parametrize("what", BAD)
def test_bad_boxes_end_in_a_mesh_that_says_what_is_open(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], what: str
) -> None:
    given = BAD[what]()
    folder = write_run(tmp_path, **given)
    assert main(["surface", str(folder), "--device", "cpu", "--faces", "2000"]) == 0
    out, err = capsys.readouterr()
    assert "Traceback" not in err and "with holes, not seen: " in out
    record = json.loads((folder / "rois/ball.surface.json").read_text())
    scale = given["sim3"].scale if "sim3" in given else 1.0
    if what in ("millimetres", "rotated"):
        plain = write_run(tmp_path / "plain")
        assert main(["surface", str(plain), "--device", "cpu", "--faces", "2000"]) == 0
        sizes = json.loads((plain / "rois/ball.surface.json").read_text())["size"]
        assert record["size"] == pytest.approx([scale * size for size in sizes], rel=0.02)
    assert trimesh.load(folder / "rois/ball.glb", force="mesh").is_empty is False


def test_an_empty_box_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_run(tmp_path, model=cloud(3000, 0, size=0.2, shift=2.0))
    assert main(["surface", str(folder), "--device", "cpu"]) == 2
    out, err = capsys.readouterr()
    assert "No photo shows a surface in box 'ball'" in err.splitlines()[-1]
    assert out == "" and "Traceback" not in err


def test_reports_get_a_line_and_a_picture_of_each_surface(run: Path) -> None:
    (run / "report.md").write_text("# Evaluation\n")
    (run / "report.html").write_text("<h1>Evaluation</h1>\n<script></script>\n</html>\n")
    for faces in ("1000", "500"):  # made again, what is said of it is replaced
        assert main(["surface", str(run), "--device", "cpu", "--faces", faces]) == 0
    text, page = ((run / name).read_text() for name in ("report.md", "report.html"))
    few = f"{json.loads((run / 'rois/ball.surface.json').read_text())['faces']} faces"
    assert text.startswith("# Evaluation\n") and text.count("faces,") == text.count(few) == 1
    assert page.count("faces,") == page.count(few) == page.count("data:image/png") == 1
    assert page.index(few) < page.index("<script>")
    (run / "rois/ball.surface.json").write_text('{"box": "ball", "faces": "<b>"}')
    add_to_reports(run)  # a damaged record: the reports say nothing of it
    assert (run / "report.md").read_text() == "# Evaluation\n"


RECORD_OF_BALL = {
    "box": "ball", "file": "rois/ball.glb", "result": "", "faces": 9, "vertices": 9, "parts": 1,
    "size": [1, 1, 1], "area": 1.0, "volume": 1.0, "watertight": True, "filled": 0.0,
    "untextured": 0.0, "unseen": {}, "voxel": 1.0, "texture": 64, "photos": 9,
}  # fmt: skip


@pytest.fixture
def reported(tmp_path: Path) -> Path:
    """A folder with reports and the record of a surface."""
    folder = tmp_path / "run"
    (folder / "rois").mkdir(parents=True)
    (folder / "rois/ball.surface.json").write_text(json.dumps(RECORD_OF_BALL))
    (folder / "report.md").write_text("# Evaluation\n")
    (folder / "report.html").write_text("<script></script>\n</html>\n")
    return folder


@pytest.mark.skipif(os.name != "posix", reason="makes links")
@pytest.mark.parametrize("content", [b"secret", PNG + b"secret"])
def test_nothing_of_elsewhere_gets_into_a_report(reported: Path, content: bytes) -> None:
    secret = reported.parent / "secret"
    secret.write_bytes(content)
    picture = reported / "rois/ball.surface.png"
    picture.symlink_to(secret)
    add_to_reports(reported)
    page = (reported / "report.html").read_text()
    assert "9 faces" in page and "data:image" not in page
    picture.unlink()
    picture.write_bytes(content)
    add_to_reports(reported)
    assert ("data:image" in (reported / "report.html").read_text()) == content.startswith(PNG)


@pytest.mark.skipif(os.name != "posix", reason="makes links")
@pytest.mark.parametrize("name", ["report.md", "rois", "rois/ball.surface.json"])
def test_links_in_a_run_folder_are_not_read_for_a_report(reported: Path, name: str) -> None:
    elsewhere = reported.parent / "elsewhere"
    (reported / name).rename(elsewhere)
    (reported / name).symlink_to(elsewhere)
    add_to_reports(reported)
    if name == "report.md":
        assert elsewhere.read_text() == "# Evaluation\n" and (reported / name).is_symlink()
    else:
        assert "9 faces" not in (reported / "report.html").read_text()


START, END = "<!-- surfaces -->\n", "<!-- end of surfaces -->\n"


@pytest.mark.parametrize(
    ("text", "left"),
    [
        (f"a\n{START}mine\n", f"a\n{START}mine\n"),
        (f"a\n{END}mine\n", f"a\n{END}mine\n"),
        (f"a\n{START}mine\n{START}old\n{END}b\n", f"a\n{START}mine\nb\n"),
        (f"a\n{START}old\n{END}b\n", "a\nb\n"),
    ],
)
def test_a_section_without_an_end_takes_nothing_away(tmp_path: Path, text: str, left: str) -> None:
    report = tmp_path / "report.md"
    report.write_text(text)
    for lines in (["new"], ["new"], []):
        put_section(report, "Surfaces", lines)
        found = report.read_text()
        assert found.replace(f"{START}new\n{END}", "") == left
        assert (f"{START}new\n{END}" in found) == bool(lines)


def test_a_background_knows_the_meshes_that_the_same_command_makes(run: Path) -> None:
    """It leaves out what they show; the same command again finds nothing to do."""
    words = ["surface", str(run), "--only", "ball", "--background", "--device", "cpu"]
    words += ["--faces", "2000", "--texture-size", "64"]
    made = run / "rois/background.glb"
    assert main(words) == 0
    first = made.read_bytes(), made.stat().st_mtime_ns
    assert main(words) == 0
    assert (made.read_bytes(), made.stat().st_mtime_ns) == first
