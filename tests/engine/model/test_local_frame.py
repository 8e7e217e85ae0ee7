"""The frame that everything is computed in: exact, and the world's for an ordinary scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from roigs_engine.formats.splat_ply import read_ply, write_ply
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.local_frame import BASE, LocalFrame
from roigs_engine.model.scene import SfmScene
from tests.engine.synthetic_scene import BOX, make_scene, truth
from tests.engine.units import in_units


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"), views=6)


def test_an_ordinary_scene_is_left_as_it_is(scene: SfmScene) -> None:
    frame = LocalFrame.of_scene(scene)
    assert frame.is_world
    assert frame.scene(scene) is scene and frame.box(BOX) is BOX


@pytest.mark.parametrize(
    ("scale", "shift"),
    [(1e-6, 0.0), (1e-3, 0.0), (0.4, 0.0), (1e6, 0.0), (1e-3, 1e6), (1.0, 1e6), (25.4, -5e6)],
)
def test_the_extent_becomes_ordinary(scene: SfmScene, scale: float, shift: float) -> None:
    moved, box = in_units(scene, BOX, scale, shift)
    frame = LocalFrame.of_scene(moved)
    local = frame.scene(moved)
    assert 1 <= local.extent() < BASE
    assert np.abs(local.centres()).max() < 1200
    roi = frame.box(box)
    # What the box contains and where it is seen does not change.
    assert (roi.contains(local.points) == BOX.contains(scene.points)).all()
    for here, there in zip(local.images, scene.images, strict=True):
        polygon = roi.silhouette_polygon(here.camera, here.world_to_camera)
        wanted = BOX.silhouette_polygon(there.camera, there.world_to_camera)
        assert polygon is not None and wanted is not None
        np.testing.assert_allclose(polygon, wanted, atol=1e-3)


@pytest.mark.parametrize("extent", [1.0, 16.0, 256.0, 16.0**-3, np.nextafter(16.0, 0)])
def test_powers_of_the_base(extent: float) -> None:
    scale = LocalFrame.around(np.zeros((1, 3)), extent).scale
    assert 1 <= extent * scale < BASE


@pytest.mark.parametrize("extent", [0.0, np.inf, np.nan])
def test_without_an_extent_it_is_the_world(extent: float) -> None:
    assert LocalFrame.around(np.ones((2, 3)), extent).is_world


def test_gaussians_go_out_and_come_back(tmp_path: Path) -> None:
    model = truth(20)
    frame = LocalFrame.around(np.full((3, 3), 4.5e6), 5e-3)
    model.save_ply(tmp_path / "far.ply", frame)
    stored = read_ply(tmp_path / "far.ply")
    assert stored["means"].dtype == np.float64  # float32 would be off by half a unit there
    world = model.means.numpy() / frame.scale + frame.origin
    np.testing.assert_array_equal(stored["means"], world)
    back = Gaussians.load_ply(tmp_path / "far.ply", frame)
    np.testing.assert_allclose(back.means, model.means, atol=1e-5)
    np.testing.assert_allclose(back.log_scales, model.log_scales, atol=2e-6)


def test_a_small_scene_stays_a_plain_file(tmp_path: Path) -> None:
    model = truth(20)
    frame = LocalFrame.around(np.zeros((3, 3)), 5e-3)
    model.save_ply(tmp_path / "small.ply", frame)
    stored = read_ply(tmp_path / "small.ply")
    assert stored["means"].dtype == np.float32
    np.testing.assert_array_equal(stored["means"] * np.float32(frame.scale), model.means)


def test_float32_positions_near_the_origin_stay_float32(tmp_path: Path) -> None:
    """Viewers read floats; and what float32 holds well needs no other frame."""
    arrays = {name: t.numpy() for name, t in truth(20).tensors().items()}
    for distance in (40.0, 900.0, 1e5):
        moved = arrays | {"means": arrays["means"] + np.float32(distance)}
        write_ply(tmp_path / "a.ply", moved)
        model, frame = Gaussians.load_framed(tmp_path / "a.ply", scaled=False)
        model.save_ply(tmp_path / "b.ply", frame)
        assert (tmp_path / "b.ply").read_bytes() == (tmp_path / "a.ply").read_bytes()
        assert LocalFrame.around(moved["means"].astype(float), 2.0).is_world == (distance < 1e3)


def test_gaussians_without_cameras() -> None:
    means = truth().means.numpy().astype(np.float64)
    assert LocalFrame.of_centres(means).is_world
    broken = np.concatenate([means * 1e-4, np.full((3, 3), np.nan), np.full((1, 3), np.inf)])
    assert LocalFrame.of_centres(broken).scale == BASE**4
    assert LocalFrame.of_centres(np.full((2, 3), np.nan)).is_world
    assert LocalFrame.of_centres(np.array([[-1e300] * 3, [1e300] * 3])).is_world
