"""The table: right masks, right means, right best model; the report; JSON there and back."""

from __future__ import annotations

import dataclasses
import json
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from roigs_engine.context import Context
from roigs_engine.errors import ConfigError, SceneError
from roigs_engine.evaluation import views
from roigs_engine.evaluation.evaluate import evaluate, ply_bytes
from roigs_engine.evaluation.report import format_markdown, write_report
from roigs_engine.evaluation.scores import (
    MIN_SILHOUETTE,
    Evaluation,
)
from roigs_engine.evaluation.views import EvaluatedModel
from roigs_engine.formats.events import Event, Message, Progress, StageStarted
from roigs_engine.model.gaussians import SH_C0, Gaussians
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import SfmScene
from roigs_engine.photos.decode import load_photo
from roigs_engine.rasterize import rasterize
from roigs_engine.rasterize import view as view_module
from tests.engine.evaluation.tables import cells
from tests.engine.synthetic_scene import BOX, make_scene, truth

FAR = OrientedBox.between("far | corner", [2.0, -0.4, -0.4], [2.8, 0.4, 0.4])
TEST = ("001.png", "004.png", "006.png")


def spoiled(inside: float, outside: float) -> Gaussians:
    """`truth` with its colours shifted in and out of the box."""
    model = truth()
    shift = torch.where(model.in_box(BOX), inside, outside)
    model.sh[:, 0] += shift[:, None]
    return model


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"), views=8)


@pytest.fixture(autouse=True)
def _reference(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(view_module, "rasterize", partial(rasterize, backend="reference"))
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)


@pytest.fixture(scope="module")
def models() -> list[EvaluatedModel]:
    return [
        EvaluatedModel(name="Full Scene", gaussians=spoiled(0.5, 0.05), seconds=90.0),
        EvaluatedModel(name="Object-GS", gaussians=spoiled(0.02, 0.4), seconds=40, rois=("thing",)),
        EvaluatedModel(name="Object-GS", gaussians=spoiled(0.5, 0.1), seconds=41, rois=(FAR.name,)),
        EvaluatedModel(
            name="Composition",
            gaussians=spoiled(0.02, 0.06),
            seconds=100.0,
            stages={"scene": 60.0, "object": 40.0},
        ),
    ]


@pytest.fixture(scope="module")
def result(scene: SfmScene, models: list[EvaluatedModel]) -> Evaluation:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(view_module, "rasterize", partial(rasterize, backend="reference"))
        patch.setitem(sys.modules, "flip_evaluator", None)
        return evaluate(models, scene, TEST, [BOX, FAR])


def db(error: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean(error.astype(np.float64))))


def test_rows_are_those_of_the_box(result: Evaluation) -> None:
    assert result.test_views == TEST
    for scores, in_box in zip(result.rois, (150, None), strict=True):
        assert [row.model for row in scores.rows] == ["Full Scene", "Object-GS", "Composition"]
        assert in_box is None or {row.gaussians_in_box for row in scores.rows} == {in_box}
    assert [row.seconds for row in result.roi(FAR.name).rows] == [90, 41, 100]
    with pytest.raises(KeyError):
        result.roi("none")


def test_the_mask_can_come_from_a_named_model(scene: SfmScene) -> None:
    sparse = truth().rows(torch.arange(0, 300, 3))
    worse = EvaluatedModel(name="Full Scene", gaussians=sparse, seconds=1.0)
    models = [worse, EvaluatedModel(name="Joint", gaussians=truth(), seconds=1.0)]
    best, named, alone = (
        evaluate(given, scene, TEST[:1], [BOX], object_mask_from=name).roi("thing")
        for given, name in ((models, None), (models, "Full Scene"), ([worse], None))
    )
    assert (best.object_mask_from, named.object_mask_from) == ("Joint", "Full Scene")
    assert named.views == alone.views != best.views
    assert named.rows[0] == alone.rows[0] != best.rows[0]
    assert named.rows[1].object_psnr not in (None, best.rows[1].object_psnr)
    with pytest.raises(ConfigError, match="Box 'thing' has no model 'best'"):
        evaluate(models, scene, TEST, [BOX], object_mask_from="best")


def test_numbers_are_those_of_a_plain_computation(
    result: Evaluation, scene: SfmScene, models: list[EvaluatedModel]
) -> None:
    scores, rows = result.roi("thing"), [0, 1, 3]
    best = models[3] if scores.object_mask_from == "Composition" else models[1]
    expected: dict[str, dict[str, list[float]]] = {}
    for name in TEST:
        image = scene.image(name)
        photo = load_photo(image) / 255.0
        mask = BOX.silhouette(image.camera, image.world_to_camera)
        depth = view_module.render_view(
            best.gaussians, image.camera, image.world_to_camera, with_depth=True
        ).depth
        assert depth is not None
        y, x = np.mgrid[: image.camera.height, : image.camera.width] + 0.5
        rays = np.stack([(x - 32) / 60, (y - 24) / 60, np.ones_like(x)], axis=-1)
        points = (rays * depth.numpy()[..., None]).reshape(-1, 3)
        to_world = np.linalg.inv(image.world_to_camera)
        inside = BOX.contains(points @ to_world[:3, :3].T + to_world[:3, 3]).reshape(mask.shape)
        pixels = mask & inside & (depth.numpy() > 0)
        for index in rows:
            model = models[index]
            view = view_module.render_view(model.gaussians, image.camera, image.world_to_camera)
            error = ((view.image.numpy() - photo) ** 2).mean(axis=-1)
            numbers = expected.setdefault(model.name, {"roi": [], "object": [], "image": []})
            numbers["roi"].append(db(error[mask]))
            numbers["object"].append(db(error[pixels]))
            numbers["image"].append(db(error))
        measured = next(view for view in scores.views if view.view == name)
        assert measured.silhouette_pixels == mask.sum()
        assert measured.object_pixels == pixels.sum() > 256
    images = [scene.image(name) for name in TEST]
    for row in scores.rows:
        numbers = expected[row.model]
        assert row.roi_psnr == pytest.approx(np.mean(numbers["roi"]), abs=1e-3)
        assert row.object_psnr == pytest.approx(np.mean(numbers["object"]), abs=1e-3)
        assert row.image_psnr == pytest.approx(np.mean(numbers["image"]), abs=1e-3)
        assert [v.roi_psnr for v in row.views] == pytest.approx(numbers["roi"], abs=1e-3)
        gains = np.subtract(numbers["roi"], expected["Full Scene"]["roi"])
        if row.model == "Full Scene":
            assert row.peak_gain is row.peak_view is None
            assert row.worst_gain is row.worst_view is row.won_share is None
        else:
            assert row.peak_gain == pytest.approx(gains.max(), abs=1e-3)
            assert row.peak_view == TEST[int(gains.argmax())]
            assert row.worst_gain == pytest.approx(gains.min(), abs=1e-3)
            assert row.worst_view == TEST[int(gains.argmin())]
            assert row.won_share == (gains > 0).mean()
        centres = [
            -np.array(i.world_to_camera)[:3, :3].T @ i.world_to_camera[:3, 3] for i in images
        ]
        distances = np.linalg.norm(np.array(centres) - BOX.centre, axis=1) / BOX.diagonal
        assert [v.distance for v in row.views] == pytest.approx(distances)
        order = np.lexsort((TEST, [v.distance for v in row.views]))
        assert row.near_psnr == pytest.approx(numbers["roi"][order[0]], abs=1e-3)
        assert row.far_psnr == pytest.approx(numbers["roi"][order[-1]], abs=1e-3)
        assert row.near_object_psnr == row.views[order[0]].object_psnr is not None
        assert row.roi_flip is None


def test_the_mask_comes_from_the_model_with_the_best_silhouette(result: Evaluation) -> None:
    for scores in result.rois:
        psnr = {row.model: row.roi_psnr or 0.0 for row in scores.rows}
        assert scores.object_mask_from == max(psnr, key=lambda name: psnr[name])


def test_a_perfect_model_scores_best(scene: SfmScene) -> None:
    perfect = EvaluatedModel(name="perfect", gaussians=truth(), seconds=1.0)
    worse = EvaluatedModel(name="worse", gaussians=spoiled(0.1, 0.1), seconds=1.0)
    scores = evaluate([worse, perfect], scene, TEST, [BOX], baseline="worse").roi("thing")
    assert scores.object_mask_from == "perfect"
    assert scores.rows[1].roi_psnr is not None
    assert scores.rows[1].roi_psnr > 55  # the photos' rounding to 8 bits is left
    assert scores.rows[1].roi_ssim == pytest.approx(1, abs=1e-3)


def test_every_view_is_rendered_once_per_model(
    scene: SfmScene, models: list[EvaluatedModel], monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def counted(*args: object, **options: object) -> object:
        calls.append(args)
        return view_module.render_view(*args, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(views, "render_view", counted)
    events: list[Event] = []
    evaluate(models[:2], scene, TEST, [BOX, FAR], context=Context(emit=events.append))
    assert len(calls) == 2 * len(TEST)
    assert next(e for e in events if not isinstance(e, Message)) == StageStarted(
        stage="evaluate", total=3
    )
    assert [e.step for e in events if isinstance(e, Progress)] == [1, 2, 3]


def small_box(half: float, name: str = "small") -> OrientedBox:
    return OrientedBox.between(name, [-half] * 3, [half] * 3)


def test_views_with_few_pixels_are_left_out(scene: SfmScene) -> None:
    sizes = {
        i.name: int(small_box(0.35).silhouette(i.camera, i.world_to_camera).sum())
        for i in scene.images
    }
    large = {name for name, size in sizes.items() if size >= MIN_SILHOUETTE}
    assert large
    assert large != set(sizes)
    model = EvaluatedModel(name="m", gaussians=truth(), seconds=1.0)
    scores = evaluate([model], scene, tuple(sizes), [small_box(0.35)]).rois[0]
    assert {view.view for view in scores.views} == large
    assert set(scores.left_out) == set(sizes) - large
    assert not any(view.small for view in scores.views)


def test_when_all_have_few_the_largest_are_taken_and_flagged(scene: SfmScene) -> None:
    model = EvaluatedModel(name="m", gaussians=truth(), seconds=1.0)
    result = evaluate([model], scene, TEST, [small_box(0.1)])
    scores = result.rois[0]
    assert scores.views
    assert all(view.small for view in scores.views)
    assert scores.rows[0].roi_psnr is not None
    assert scores.rows[0].object_psnr is None  # fewer than 256 pixels
    assert "Fewer than 1024 pixels, used" in format_markdown(result)


def test_camera_inside_takes_the_whole_image(scene: SfmScene) -> None:
    model = EvaluatedModel(name="m", gaussians=truth(), seconds=1.0)
    result = evaluate([model], scene, TEST, [small_box(4.0, "room")])
    assert all(view.camera_inside for view in result.rois[0].views)
    row = result.rois[0].rows[0]
    assert row.roi_psnr == pytest.approx(row.image_psnr)
    assert "Camera inside" in format_markdown(result)


def test_a_box_that_no_test_photo_shows(scene: SfmScene) -> None:
    away = OrientedBox.between("away", [0, 0, 50], [1, 1, 51])
    model, events = EvaluatedModel(name="m", gaussians=truth(), seconds=0.0), []
    result = evaluate([model], scene, TEST, [away], context=Context(emit=events.append))
    row = result.rois[0].rows[0]
    assert row.roi_psnr is row.roi_ssim is row.object_psnr is row.peak_gain is None
    assert any(isinstance(e, Message) and e.level == "warning" and "away" in e.text for e in events)
    line = next(line for line in format_markdown(result).splitlines() if line.startswith("| m "))
    assert cells(line)[1:4] == ["–"] * 3
    assert cells(line)[7] == "–"
    assert "Near and far" not in format_markdown(result)
    assert "No FLIP" not in format_markdown(result)


def test_flip_is_measured_if_the_package_is_there(
    scene: SfmScene, models: list[EvaluatedModel], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fake(reference: np.ndarray, test: np.ndarray, *_: str, **__: bool) -> tuple[np.ndarray]:
        return (np.abs(reference - test).mean(axis=-1, keepdims=True),)

    monkeypatch.setitem(sys.modules, "flip_evaluator", SimpleNamespace(evaluate=fake))
    result = evaluate([models[0], models[3]], scene, TEST[:1], [BOX])
    image = scene.image(TEST[0])
    mask = BOX.silhouette(image.camera, image.world_to_camera)
    for row, model in zip(result.rois[0].rows, (models[0], models[3]), strict=True):
        view = view_module.render_view(model.gaussians, image.camera, image.world_to_camera)
        error = np.abs(view.image.numpy() - load_photo(image) / 255.0).mean(axis=-1)
        assert row.roi_flip == row.views[0].roi_flip == pytest.approx(error[mask].mean(), abs=1e-6)
        assert row.near_psnr is row.far_psnr is None  # a single photo
    text = format_markdown(result)
    assert "Andersson" in text and "No FLIP" not in text
    header, _, *rows = next(b for b in text.split("\n\n") if "| Method" in b).splitlines()
    assert cells(header)[5] == "ROI FLIP"
    assert [cells(row)[5].startswith("**") for row in rows] == [False, True]  # the lower one


def test_a_picture_in_other_light_is_right_when_corrected(scene: SfmScene) -> None:
    tinted = truth()
    tinted.sh[:, 0] += (tinted.sh[:, 0] + 0.5 / SH_C0) * torch.tensor([0.2, -0.1, -0.3])
    tinted.sh[:, 1:] *= torch.tensor([1.2, 0.9, 0.7])
    models = [
        EvaluatedModel(name=name, gaussians=gaussians, seconds=1.0)
        for name, gaussians in (("Full Scene", truth()), ("Joint", tinted))
    ]
    right, other = evaluate(models, scene, TEST, [BOX]).roi("thing").rows
    assert right.roi_psnr and other.roi_psnr and right.roi_psnr > other.roi_psnr + 5
    assert right.corrected_psnr and other.corrected_psnr
    assert right.corrected_psnr >= right.roi_psnr
    assert other.corrected_psnr > other.roi_psnr + 4
    assert other.corrected_psnr == pytest.approx(
        np.mean([view.corrected_psnr for view in other.views])
    )


def test_refusals(scene: SfmScene, models: list[EvaluatedModel]) -> None:
    with pytest.raises(SceneError, match=r"none\.png"):
        evaluate(models, scene, ["none.png"], [BOX])
    with pytest.raises(SceneError):
        evaluate(models, scene, [], [BOX])
    with pytest.raises(ConfigError):
        evaluate([], scene, TEST, [BOX])
    with pytest.raises(ConfigError, match="Full Scene"):
        evaluate([models[0], dataclasses.replace(models[0])], scene, TEST, [BOX])


def test_ply_size_is_that_of_the_file(tmp_path: Path) -> None:
    model = truth()
    model.save_ply(tmp_path / "m.ply")
    assert 0 < (tmp_path / "m.ply").stat().st_size - ply_bytes(model) < 3000


def test_markdown_table(result: Evaluation) -> None:
    text = format_markdown(result)
    assert text.startswith("# Evaluation on 3 test photos")
    tables = [block.splitlines() for block in text.split("\n\n") if block.startswith("| Method")]
    assert len(tables) == 4
    for table, scores in zip(tables[::2], result.rois, strict=True):
        header, rule, *rows = table
        assert len(cells(header)) == 11
        assert all(set(cell) <= set("-:") for cell in cells(rule))
        assert [cells(row)[0] for row in rows] == [row.model for row in scores.rows]
        assert len({len(line) for line in table}) == 1
        psnr = [cells(row)[1] for row in rows]
        values = [float(cell.strip("*")) for cell in psnr]
        assert values == pytest.approx([row.roi_psnr for row in scores.rows], abs=0.005)
        bold = [cell.startswith("**") for cell in psnr]
        assert bold == [value == max(values) for value in values]
        seconds = [cells(row)[9] for row in rows]
        assert seconds[1] in ("**40**", "**41**")
    assert "scene 60 + object 40" in text
    assert "sigma 1.5" in text
    assert "No FLIP: `pip install flip-evaluator`" in text


def test_json_there_and_back(result: Evaluation, tmp_path: Path) -> None:
    markdown, record = write_report(result, tmp_path / "run")
    assert markdown.read_text(encoding="utf-8") == format_markdown(result)
    document = json.loads(record.read_text(encoding="utf-8"))
    assert document == result.to_dict()
    assert Evaluation.from_dict(document) == result
    assert {path.name for path in (tmp_path / "run").iterdir()} == {"report.md", "report.json"}
