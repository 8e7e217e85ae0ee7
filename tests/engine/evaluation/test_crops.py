"""Side-by-side pictures: which photos, what part of them, the box's outline."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial.transform import Rotation

from roigs_engine.evaluation.crops import (
    GAP,
    STRIP,
    box_lines,
    choose_views,
    crop_window,
    write_crops,
)
from roigs_engine.evaluation.evaluate import evaluate
from roigs_engine.evaluation.scores import Evaluation, ModelScore, ViewScore
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import Camera, SfmScene
from roigs_engine.photos.profiles import srgb_curve, srgb_values
from roigs_engine.rasterize import rasterize, view
from tests.engine.evaluation.tables import score
from tests.engine.evaluation.two_models import TEST, two_models
from tests.engine.synthetic_scene import BOX, make_scene

CAMERA = Camera(width=80, height=60, fx=70.0, fy=75.0, cx=41.0, cy=28.5)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"), views=5)


@pytest.fixture(scope="module")
def evaluation(scene: SfmScene) -> Evaluation:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(view, "rasterize", partial(rasterize, backend="reference"))
        return evaluate(two_models(), scene, TEST, [BOX])


@pytest.fixture(autouse=True)
def _reference(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(view, "rasterize", partial(rasterize, backend="reference"))


def scored(model: str, psnr: dict[str, float]) -> ModelScore:
    views = tuple(ViewScore(view=k, roi_psnr=v, roi_ssim=0.9) for k, v in psnr.items())
    return score(model, views)


def test_largest_median_and_least_gain_are_shown() -> None:
    base = scored("base", {"a": 20, "b": 20, "c": 20, "d": 20, "e": 20})
    ours = scored("ours", {"a": 21, "b": 25, "c": 19, "d": 22, "e": 20.5})
    assert choose_views(ours, base) == {
        "b": "largest gain",
        "a": "median gain",
        "c": "least gain",
    }
    assert choose_views(base, base)["a"] == "largest PSNR"


def test_the_nearest_photo_is_shown_too_but_not_twice() -> None:
    base = scored("base", {"a": 20, "b": 20, "c": 20, "d": 20, "e": 20})
    gains = {"a": 21.0, "b": 25.0, "c": 19.0, "d": 22.0, "e": 20.5}
    for nearest, label in (("d", "nearest"), ("b", "largest gain")):
        views = tuple(
            ViewScore(view=k, roi_psnr=v, roi_ssim=0.9, distance=1.0 if k == nearest else 2.0)
            for k, v in gains.items()
        )
        chosen = choose_views(score("ours", views), base)
        assert chosen[nearest] == label
        assert len(chosen) == (4 if label == "nearest" else 3)


def test_few_photos_are_not_shown_twice() -> None:
    base, ours = scored("base", {"a": 20}), scored("ours", {"a": 21})
    assert choose_views(ours, base) == {"a": "largest gain"}
    base, ours = scored("base", {"a": 20, "b": 20}), scored("ours", {"a": 21, "b": 22})
    assert set(choose_views(ours, base)) == {"a", "b"}


def test_pictures_of_a_box(scene: SfmScene, evaluation: Evaluation, tmp_path: Path) -> None:
    models = two_models()
    written = write_crops(evaluation, models, scene, [BOX], tmp_path)
    folder = tmp_path / "crops" / "thing"
    assert set(folder.iterdir()) == set(written)
    assert len(written) == 5
    assert written[-1].name == "overview.png"
    for path in written:
        with Image.open(path) as picture:
            assert picture.mode == "RGB"
            assert 400 <= picture.height <= 760
            assert picture.width > picture.height
    only = write_crops(evaluation, models, scene, [BOX], tmp_path / "b", names=["Ours"])
    assert len(only) == 4  # the nearest photo is one of the three
    for one, both in zip(only[:3], written[:3], strict=True):
        assert Image.open(one).width < Image.open(both).width


def test_all_panels_have_the_photo_s_own_exposure(
    scene: SfmScene, evaluation: Evaluation, tmp_path: Path
) -> None:
    """A brighter photo is not shown levelled, which would be clipped and grey."""
    brighter = replace(scene, images=tuple(replace(i, exposure=1.0) for i in scene.images))
    sheets = []
    for name, photos in (("plain", scene), ("brighter", brighter)):
        path, *_ = write_crops(evaluation, two_models(), photos, [BOX], tmp_path / name)
        sheets.append(np.asarray(Image.open(path)))
    image = scene.image(path.name.removesuffix(".png"))
    rows, columns = crop_window(BOX, image.camera, image.world_to_camera)
    factor = (sheets[0].shape[0] - STRIP) // (rows.stop - rows.start)
    width = factor * (columns.stop - columns.start)
    plain, bright = (sheet[: -STRIP - 1] for sheet in sheets)
    np.testing.assert_array_equal(bright[:, :width], plain[:, :width])
    render, doubled = plain[:, width + GAP :], bright[:, width + GAP :]
    light = 2 * srgb_curve(render / 255)
    close = np.abs(srgb_values(light.clip(0, 1)) * 255 - doubled) <= 2
    assert close[(render > 30) & (render < 235)].mean() > 0.95 and (light > 0.1).any()


def test_first_panel_holds_the_photo_s_pixels(
    scene: SfmScene, evaluation: Evaluation, tmp_path: Path
) -> None:
    models = two_models()
    path, *_ = write_crops(evaluation, models, scene, [BOX], tmp_path)
    image = scene.image(path.name.removesuffix(".png"))
    rows, columns = crop_window(BOX, image.camera, image.world_to_camera)
    photo = np.asarray(Image.open(image.path))[rows, columns]
    sheet = np.asarray(Image.open(path))
    factor = (sheet.shape[0] - STRIP) // photo.shape[0]
    assert factor >= 8
    panel = sheet[: photo.shape[0] * factor, : photo.shape[1] * factor]
    assert np.array_equal(panel[factor // 2 :: factor, factor // 2 :: factor], photo)


def test_window_is_the_silhouette_with_a_margin() -> None:
    box = OrientedBox.between("a", [-0.5, -0.5, 5], [0.5, 0.5, 5.1])
    mask = box.silhouette(CAMERA, np.eye(4))
    rows, columns = crop_window(box, CAMERA, np.eye(4))
    ys, xs = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    margin = round(0.1 * max(len(ys), len(xs)))
    assert (rows.start, rows.stop) == (ys[0] - margin, ys[-1] + 1 + margin)
    assert (columns.start, columns.stop) == (xs[0] - margin, xs[-1] + 1 + margin)
    away = OrientedBox.between("b", [-1, -1, -9], [1, 1, -8])
    assert crop_window(away, CAMERA, np.eye(4)) == (slice(0, 60), slice(0, 80))


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.5, 2.0, 6.0]))
def test_outline_stays_in_the_picture_and_on_the_box(seed: int, distance: float) -> None:
    rng = np.random.default_rng(seed)
    transform, pose = np.eye(4), np.eye(4)
    transform[:3, :3] = Rotation.random(random_state=rng.integers(2**31)).as_matrix()
    pose[:3, :3] = Rotation.random(random_state=rng.integers(2**31)).as_matrix()
    pose[:3, 3] = rng.normal(size=3) * distance
    box = OrientedBox(name="a", world_to_box=transform, half_extents=rng.uniform(0.3, 2, 3))
    lines = np.array(box_lines(box, CAMERA, pose)).reshape(-1, 4)
    assert (lines[:, 0::2] > -1e-6).all() and (lines[:, 0::2] < 80 + 1e-6).all()
    assert (lines[:, 1::2] > -1e-6).all() and (lines[:, 1::2] < 60 + 1e-6).all()
    polygon = None if box.camera_inside(pose) else box.silhouette_polygon(CAMERA, pose)
    if polygon is not None:
        low, high = polygon.min(axis=0), polygon.max(axis=0)
        ends = lines.reshape(-1, 2)
        assert (ends >= low - 1e-6).all() and (ends <= high + 1e-6).all()
