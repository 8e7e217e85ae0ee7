"""Texels as the viewport's shader reads them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from roigs_addon.geometry.splat_cloud import SplatCloud, read_splats
from roigs_addon.viewport.packing import INDEX_MARK, ROW, pack, pack_order
from tests.addon.splat_cases import random_ply


@pytest.fixture
def clouds(tmp_path: Path) -> list[SplatCloud]:
    sizes = [(3000, 1), (50, 4), (0, 1), (200, 9), (100, 16)]
    return [
        read_splats(random_ply(tmp_path / f"{k}.ply", count, k, coefficients))
        for k, (count, coefficients) in enumerate(sizes)
    ]


def test_every_gaussian_has_its_texels(clouds: list[SplatCloud]) -> None:
    packed = pack(clouds)
    assert len(packed) == 3350
    assert packed.sh_texels == 4
    assert packed.ranges == ((0, 3000), (3000, 3050), (3050, 3050), (3050, 3250), (3250, 3350))
    for array in (packed.geometry, packed.colours):
        assert array.shape[1:] == (ROW, 4) and array.dtype == np.float32
    geometry, colours = packed.geometry.reshape(-1, 4), packed.colours.reshape(-1, 4)
    for number, (cloud, (start, _)) in enumerate(zip(clouds, packed.ranges, strict=True)):
        for row in range(0, len(cloud), 17):
            place, quat, size = geometry[3 * (start + row) :][:3]
            np.testing.assert_array_equal(place, [*cloud.means[row], cloud.opacities[row]])
            np.testing.assert_array_equal(quat, cloud.quats[row])
            np.testing.assert_array_equal(size, [*cloud.scales[row], number])
            texels = colours[12 * (start + row) :][:12].reshape(3, 16).T
            held = cloud.sh.shape[1]
            np.testing.assert_array_equal(texels[:held], cloud.sh[row])
            assert not texels[held:].any()


def test_each_gaussian_knows_whether_it_is_anti_aliased(tmp_path: Path) -> None:
    clouds = [
        read_splats(random_ply(tmp_path / f"{k}.ply", 4, antialiased=k in (0, 2))) for k in range(4)
    ]
    numbers = pack(clouds).geometry.reshape(-1, 4)[2 : 3 * 16 : 3, 3]
    np.testing.assert_array_equal(numbers, np.repeat([0.5, 1, 2.5, 3], 4))


@pytest.mark.parametrize(("coefficients", "texels"), [(1, 1), (4, 1), (9, 3), (16, 4)])
def test_no_more_texels_than_the_colours_need(
    tmp_path: Path, coefficients: int, texels: int
) -> None:
    cloud = read_splats(random_ply(tmp_path / "a.ply", 5, coefficients=coefficients))
    assert pack([cloud]).sh_texels == texels


def test_an_empty_set() -> None:
    assert len(pack([])) == 0
    assert pack_order(np.zeros(0, np.uint32)).shape == (1, ROW)


def test_indices_travel_as_normal_floats() -> None:
    order = np.array([0, 1, 2**24 + 1, 2**29 - 1], np.uint32)
    texels = pack_order(order)
    stored = texels.reshape(-1)[:4]
    assert np.isfinite(stored).all() and (np.abs(stored) >= np.finfo(np.float32).tiny).all()
    np.testing.assert_array_equal(stored.view(np.uint32) & (INDEX_MARK - 1), order)
    assert pack_order(np.arange(ROW + 1, dtype=np.uint32)).shape == (2, ROW)
