"""The scores of `benchmarks.insertion`, on pictures whose values are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.insertion import scores, views

SHAPE = (20, 30)


def grey(value: float) -> scores.Picture:
    return np.full((*SHAPE, 3), value)


def part(rows: slice, columns: slice) -> scores.Mask:
    mask = np.zeros(SHAPE, bool)
    mask[rows, columns] = True
    return mask


def test_a_picture_is_compared_as_it_is_shown_and_on_the_mask_alone() -> None:
    truth, ours = grey(0.0), grey(0.0)
    mask = part(slice(5), slice(5))
    ours[mask] = 0.0031308  # 0.04045 in sRGB
    assert scores.psnr(ours, truth, mask) == pytest.approx(-20 * np.log10(0.04045), abs=0.01)
    assert scores.psnr(ours, truth, ~mask) == 100
    assert scores.psnr(grey(1.0), grey(7.0), mask) == 100  # both are white


def test_shadows_are_where_the_truth_gets_darker_but_not_on_things() -> None:
    before, after = grey(0.4), grey(0.4)
    after[5:10] *= 0.9
    after[:5] *= 0.98
    thing = part(slice(5, 10), slice(10))
    left = scores.ratio(after, before)
    shadow = scores.in_shadow(left, thing)
    np.testing.assert_array_equal(shadow, part(slice(5, 10), slice(10, None)))
    assert scores.shadow_error(left, left, shadow) == 0
    assert scores.shadow_error(np.ones_like(left), left, shadow) == pytest.approx(1)
    assert scores.shadow_error(2 * left - 1, left, shadow) == pytest.approx(1)  # twice as dark
    assert scores.shadow_error((left + 1) / 2, left, shadow) == pytest.approx(0.5)


def test_noise_on_textures_is_no_shadow() -> None:
    random = np.random.default_rng(0)
    before = grey(0.5) * random.uniform(0.2, 1, (*SHAPE, 1))
    after = before * random.normal(1, 0.1, (*SHAPE, 3))
    after[10:] *= 0.7
    thing = part(slice(8, 12), slice(14, 16))
    after[thing] = 100.0  # what shows a thing is not in the mean of its neighbours
    left = scores.smooth_ratio(after, before, thing)
    assert np.abs(left[:8] - 1).max() < 0.12 and np.abs(left[13:] - 0.7).max() < 0.1
    assert np.abs(left[8:12][:, [13, 16]] - 0.85).max() < 0.25


def test_a_change_of_light_has_a_side_and_a_colour() -> None:
    across = np.linspace(1, 2, SHAPE[1])[None, :, None]
    truth = across ** np.array([1.0, 0.6, 0.3]) * np.ones((*SHAPE, 1))
    all_of_it = np.ones(SHAPE, bool)
    assert scores.likeness(truth, truth, all_of_it) == pytest.approx(1)
    assert scores.likeness(truth**0.5, truth, all_of_it) == pytest.approx(1)
    assert scores.strength(truth**0.5, truth, all_of_it) == pytest.approx(0.5)
    assert scores.likeness(truth[:, ::-1], truth, all_of_it) < 0.1  # from the other side
    blue = scores.likeness(truth[..., ::-1], truth, all_of_it)
    assert blue < 0.8  # of another colour
    assert scores.likeness(grey(1.0), truth, all_of_it) == 0
    assert scores.likeness(1 / truth, truth, all_of_it) == pytest.approx(-1)


def folders(at: Path) -> tuple[Path, Path]:
    """The truth of a photo, in which each thing is a column, the vase the last; and ours."""
    truth, ours = at / "truth", at / "ours"
    index = np.zeros(SHAPE, np.uint8)
    for number in range(1, views.VASE + 1):
        index[:10, 5 * number - 4 : 5 * number] = number
    states = {"index": index, "without": grey(0.5), "with": grey(0.5), "lamp": grey(0.5)}
    states["with"][index > 0] = 0.2
    states["with"][12:] *= 0.8
    states["lamp"][:, 20:] *= np.linspace(1, 2, 10)[:, None]
    for folder in (truth, ours):
        folder.mkdir()
        for state, picture in states.items():
            np.save(views.picture_file(folder, "wide/a.jpg", state), picture)
    return truth, ours


def test_pictures_like_the_truth_have_all_measures(tmp_path: Path) -> None:
    truth, ours = folders(tmp_path)
    found = views.measured(ours, truth, "wide/a.jpg").found
    assert set(found) == set(views.MEASURES)
    assert found["shadow"] == 0 and found["lamp"] == pytest.approx(1)
    assert found["monkey (dB)"] == 100
    np.save(views.picture_file(ours, "wide/a.jpg", "with"), grey(0.5))
    worse = views.measured(ours, truth, "wide/a.jpg").found
    assert worse["shadow"] == pytest.approx(1) and worse["monkey (dB)"] < 20
    views.picture_file(ours, "wide/a.jpg", "lamp").unlink()
    rest = views.measured(ours, truth, "wide/a.jpg")
    assert "lamp" not in rest.found
    assert views.means([rest, views.View(photo="b", found={"shadow": 0.0})])["shadow"] == 0.5


def test_photos_that_show_most_of_the_things_are_compared(tmp_path: Path) -> None:
    for name, rows in (("a.jpg", 2), ("b.jpg", 0), ("c.jpg", 9)):
        index = np.zeros(SHAPE, np.uint8)
        index[:rows] = 3
        np.save(views.picture_file(tmp_path, name, "index"), index)
    photos = ["c.jpg", "b.jpg", "a.jpg"]
    assert views.photos_that_show_most(tmp_path, photos, 2) == ["c.jpg", "a.jpg"]
    assert views.photos_that_show_most(tmp_path, photos, 1) == ["c.jpg"]


def test_a_truth_that_is_not_whole_is_scored_as_far_as_it_goes(tmp_path: Path) -> None:
    np.save(views.picture_file(tmp_path, "wide/a.jpg", "index"), np.ones((4, 6), np.uint8))
    assert views.photos_that_show_most(tmp_path, ["wide/a.jpg", "wide/b.jpg"]) == ["wide/a.jpg"]
