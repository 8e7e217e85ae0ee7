"""`convert`: models in their places as one file."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.app.instances import read_list
from roigs_engine.cli import main
from roigs_engine.context import Context
from roigs_engine.errors import Stopped
from roigs_engine.exchange.formats import target_of
from roigs_engine.formats.splat_ply import read_ply
from roigs_engine.formats.targets import EEVEE, VIEWERS
from roigs_engine.model.gaussians import Gaussians
from tests.engine.clouds import TURN, affine, cloud
from tests.engine.commands.command_line import refused, start


@pytest.fixture
def ply(tmp_path: Path) -> Path:
    """A model's file."""
    cloud().save_ply(tmp_path / "vase.ply")
    return tmp_path / "vase.ply"


def listed(folder: Path, *models: dict[str, object]) -> Path:
    path = folder / "placed.json"
    path.write_text(json.dumps({"models": models}))
    return path


def test_a_plain_ply_stays_bit_for_bit(ply: Path, tmp_path: Path) -> None:
    assert main(["convert", str(ply), str(tmp_path / "out.ply")]) == 0
    before, after = read_ply(ply), read_ply(tmp_path / "out.ply")
    for name, values in before.items():
        np.testing.assert_array_equal(after[name], values)


def test_higher_degrees_are_left_out(ply: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.ply"
    assert main(["convert", str(ply), str(out), "--sh-degree", "1"]) == 0
    np.testing.assert_array_equal(read_ply(out)["sh"], read_ply(ply)["sh"][:, :4])
    assert out.stat().st_size < 0.5 * ply.stat().st_size


def test_placed_models_become_one(ply: Path, tmp_path: Path) -> None:
    matrix = affine(2 * TURN, (1, 2, 3))
    models = [{"ply": str(ply), "matrix": m.tolist()} for m in (matrix, np.eye(4))]
    out = tmp_path / "out.ply"
    assert main(["convert", str(listed(tmp_path, *models)), str(out)]) == 0
    found = read_ply(out)
    expected = cloud().means.numpy() @ matrix[:3, :3].T + matrix[:3, 3]
    np.testing.assert_allclose(found["means"][:60], expected, atol=1e-4)
    np.testing.assert_allclose(found["means"][60:], cloud().means, atol=1e-5)
    np.testing.assert_allclose(
        np.sort(found["log_scales"][:60]), np.sort(cloud().log_scales + np.log(2)), atol=1e-4
    )


@pytest.mark.parametrize(
    ("models", "said"),
    [
        ([], "it has no model"),
        ([{"file": "a.ply"}], "malformed (a model has no 'ply')"),
        ([{"ply": "a.ply"}], "malformed (a model has no 'matrix')"),
        ([["ply"]], "malformed"),
        ([{"ply": "a.ply", "matrix": [[1, 2]]}], "4 x 4"),
        ([{"ply": "a.ply", "matrix": np.zeros((4, 4)).tolist()}], "affine"),
        ([{"ply": "gone.ply", "matrix": np.eye(4).tolist()}], "gone.ply"),
    ],
)
def test_malformed_lists_are_one_line(
    models: list[dict[str, object]], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = listed(tmp_path, *models)
    assert main(["convert", str(path), str(tmp_path / "out.ply")]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert "Traceback" not in error
    assert not (tmp_path / "out.ply").exists()


def test_a_list_without_models_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for text in ("{}", "[]", "3"):
        (tmp_path / "placed.json").write_text(text)
        said = refused(capsys, "convert", tmp_path / "placed.json", tmp_path / "out.ply")
        assert "placed.json is malformed" in said


def test_a_list_for_which_memory_is_too_small_is_one_line(
    ply: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.ply"
    out.write_bytes(b"earlier")
    model = {"ply": str(ply), "matrix": np.eye(4).tolist()}
    monkeypatch.setattr("roigs_engine.app.conversion.models.machine_memory", lambda: 1_000_000)
    said = refused(capsys, "convert", listed(tmp_path, *[model] * 1000), out)
    assert "lists 60,000 Gaussians in all, which need 0.1 GB of memory" in said
    assert out.read_bytes() == b"earlier"
    assert main(["convert", str(listed(tmp_path, model)), str(out)]) == 0


def test_a_long_list_is_stopped_while_it_is_read(ply: Path, tmp_path: Path) -> None:
    models = listed(tmp_path, *[{"ply": str(ply), "matrix": np.eye(4).tolist()}] * 20)
    calls = 0

    def stop() -> bool:
        nonlocal calls
        calls += 1
        return calls > 10

    with pytest.raises(Stopped):
        read_list(models, Context(should_stop=stop))
    assert calls == 11


def test_relative_paths_of_a_list_start_at_its_folder(
    ply: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And not where the command is started, so that a list can be moved with its files."""
    models = listed(tmp_path, {"ply": ply.name, "matrix": np.eye(4).tolist()})
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    for number, path in enumerate((models, Path("..") / models.name)):
        assert main(["convert", str(path), f"{number}.ply"]) == 0
        assert len(read_ply(f"{number}.ply")["means"]) == len(cloud())


def test_inputs_are_not_replaced(
    ply: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = ply.read_bytes()
    models = listed(tmp_path, {"ply": str(ply), "matrix": np.eye(4).tolist()})
    assert main(["convert", str(models), str(ply)]) == 2
    assert main(["convert", str(ply), str(ply)]) == 2
    assert "is an input" in capsys.readouterr().err
    assert ply.read_bytes() == before


def test_what_a_list_leaves_out_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    broken = cloud()
    broken.quats[:3] = 0
    broken.logit_opacities[3:6] = np.inf
    broken.save_ply(tmp_path / "broken.ply")
    models = [{"ply": "broken.ply", "matrix": np.eye(4).tolist()}] * 2
    assert main(["convert", str(listed(tmp_path, *models)), str(tmp_path / "out.ply")]) == 0
    assert capsys.readouterr().out.startswith("114 Gaussians (6 left out), ")


def test_a_model_without_gaussians_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    empty = tmp_path / "empty.ply"
    cloud().rows(cloud().means[:, 0] > 1e9).save_ply(empty)
    models = listed(tmp_path, {"ply": str(empty), "matrix": np.eye(4).tolist()})
    assert main(["convert", str(models), str(tmp_path / "out.ply")]) == 2
    assert "has no Gaussians" in capsys.readouterr().err


def test_other_names_of_files_are_refused(
    ply: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["convert", str(ply), str(tmp_path / "out.xyz")]) == 2
    assert ".compressed.ply, .ply, .spz" in capsys.readouterr().err
    assert isinstance(Gaussians.load_ply(ply), Gaussians)


def test_a_stop_leaves_no_file(ply: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.ply"
    process = start("convert", ply, out, "--up", "z", "--events")
    text, _ = process.communicate("stop\n", timeout=60)
    assert json.loads(text.splitlines()[-1])["stopped"] and process.returncode == 3
    assert not out.exists()


SIDE = {"name": "side", "min": [-9, 0.1, -9], "max": [9, 9, 9]}
"""A box around what has positive y in the scene."""


@pytest.mark.parametrize("suffix", [".ply", ".spz", ".glb", ".usdc", ".splat"])
def test_boxes_are_in_the_scene_whichever_way_is_up_in_the_file(
    suffix: str, ply: Path, tmp_path: Path
) -> None:
    """Formats with y up were cropped to a box that stood upside down."""
    for package in {".spz": ("gsply",), ".glb": ("pygltflib",), ".usdc": ("pxr",)}.get(suffix, ()):
        pytest.importorskip(package)
    made, out = tmp_path / f"made{suffix}", tmp_path / "out.ply"
    (tmp_path / "rois.json").write_text(json.dumps({"rois": [SIDE]}))
    boxes = ["--rois", str(tmp_path / "rois.json")]
    assert main(["convert", str(ply), str(made)]) == 0
    assert main(["convert", str(made), str(out), *boxes]) == 0
    assert (read_ply(out)["means"][:, 1] > 0.09).all()
    assert abs(len(read_ply(out)["means"]) - (cloud().means[:, 1] > 0.1).sum()) < 3
    # A scene with z up, to a file with y up and back.
    assert main(["convert", str(ply), str(made), "--from-up=z"]) == 0
    back = [] if suffix in (".ply", ".splat") else ["--up=z"]
    if back:
        assert main(["convert", str(made), str(out), *back, *boxes]) == 0
        assert (read_ply(out)["means"][:, 1] > 0.09).all()


def test_buttons_of_a_page_are_where_the_boxes_are(ply: Path, tmp_path: Path) -> None:
    pytest.importorskip("gsply")
    (tmp_path / "rois.json").write_text(json.dumps({"rois": [SIDE]}))
    targets = []
    assert main(["convert", str(ply), str(tmp_path / "vase.spz")]) == 0
    for source in ("vase.ply", "vase.spz"):
        page = tmp_path / f"{source}.html"
        fly = ["--fly-to", str(tmp_path / "rois.json")]
        assert main(["convert", str(tmp_path / source), str(page), *fly]) == 0
        text = page.read_text(encoding="utf-8")
        found = re.search(r'<script id="page" type="application/json">(.*?)</script>', text)
        assert found is not None
        targets.append(json.loads(found[1])["places"][1]["target"])
    np.testing.assert_allclose(targets[1], targets[0], atol=1e-6)
    assert targets[0][1] == pytest.approx(-4.55)  # y points up in a page


def test_the_hint_names_the_argument(
    ply: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["convert", str(ply), str(ply)]) == 2
    assert "Choose another OUT." in capsys.readouterr().err


def smooth(folder: Path) -> Path:
    """An anti-aliased model's file."""
    replace(cloud(), target=VIEWERS).save_ply(folder / "smooth.ply")
    return folder / "smooth.ply"


WAYS: dict[str, list[str]] = {
    "as it is": [],
    "turned": ["--up=z"],
    "cropped": ["--roi", "a=-9,0.1,-9,9,9,9"],
    "without SH": ["--sh-degree=0"],
}


@pytest.mark.parametrize("suffix", [".ply", ".compressed.ply", ".spz", ".sog"])
@pytest.mark.parametrize("way", WAYS)
def test_antialiasing_stays(suffix: str, way: str, tmp_path: Path) -> None:
    needs = {".ply": (), ".sog": ("gsply", "imagecodecs", "sklearn")}.get(suffix, ("gsply",))
    for package in needs:
        pytest.importorskip(package)
    made, back = tmp_path / f"made{suffix}", tmp_path / "back.ply"
    assert main(["convert", str(smooth(tmp_path)), str(made), *WAYS[way]]) == 0
    assert main(["convert", str(made), str(back)]) == 0
    assert target_of(made).antialiased and target_of(back).antialiased


def test_models_of_a_list_stay_antialiased_and_must_agree(
    ply: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one, out = {"ply": str(smooth(tmp_path)), "matrix": np.eye(4).tolist()}, tmp_path / "out.ply"
    turned = {**one, "matrix": affine(2 * TURN, (1, 2, 3)).tolist(), "density": 0.5}
    assert main(["convert", str(listed(tmp_path, one, turned)), str(out)]) == 0
    assert target_of(out).antialiased
    out.unlink()
    capsys.readouterr()
    models = listed(tmp_path, one, {**one, "ply": str(ply)})
    error = refused(capsys, "convert", models, out)
    assert "smooth.ply" in error and "vase.ply" in error
    assert "for Splat Viewers" in error and "for Viewers without Anti-Aliasing" in error
    assert "--plain" in error and not out.exists()
    assert main(["convert", str(models), str(tmp_path / "out.splat")]) == 0  # plain, all of it


@pytest.mark.parametrize("suffix", [".glb", ".usdc", ".splat"])
def test_formats_without_antialiasing_are_warned_of_once(
    suffix: str, ply: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for package in {".glb": ("pygltflib",), ".usdc": ("pxr",)}.get(suffix, ()):
        pytest.importorskip(package)
    for source, times in ((ply, 0), (smooth(tmp_path), 1)):
        assert main(["convert", str(source), str(tmp_path / f"out{suffix}")]) == 0
        said = capsys.readouterr()
        assert (said.out + said.err).count("programs will show fine ones too thick") == times


@pytest.mark.parametrize("suffix", [".ply", ".compressed.ply", ".spz", ".splat", ".html"])
def test_only_plys_keep_linear_light(
    suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if suffix in (".compressed.ply", ".spz", ".html"):
        pytest.importorskip("gsply")
    out, source = tmp_path / f"out{suffix}", tmp_path / "a.ply"
    replace(cloud(), target=EEVEE).save_ply(source)
    assert main(["convert", str(source), str(out)]) == 0
    kept = suffix.endswith(".ply")
    warned = "made for Blender 5.3, EEVEE: other programs will show them too dark"
    assert (warned in capsys.readouterr().err) != kept
    assert not kept or target_of(out) == EEVEE


def test_formats_with_antialiasing_are_not_warned_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("gsply")
    for suffix in (".ply", ".spz", ".html"):
        assert main(["convert", str(smooth(tmp_path)), str(tmp_path / f"out{suffix}")]) == 0
    assert "warning" not in capsys.readouterr().err
