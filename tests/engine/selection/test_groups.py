"""Boxes are grouped by the photos that they share, or as the user says."""

from __future__ import annotations

import time

import numpy as np
import pytest

from roigs_engine.errors import ConfigError
from roigs_engine.model.roi import OrientedBox
from roigs_engine.selection.cells import groups_by_photos, nearest_group, parsed_groups

BOXES = ["vase", "tin", "clock"]


def photos(*ranges: range) -> set[str]:
    return {str(k) for one in ranges for k in one}


def test_boxes_that_share_photos_are_near() -> None:
    seen = {
        "vase": photos(range(20)),
        "clock": photos(range(100, 120)),
        "tin": photos(range(10, 30)),
        "lamp": photos(range(117, 200)),  # shares 3 of 20 with the clock
    }
    assert groups_by_photos(seen) == (("vase", "tin"), ("clock",), ("lamp",))


def test_boxes_with_a_common_neighbour_are_together() -> None:
    seen = {
        "a": photos(range(20)),
        "b": photos(range(30, 50)),
        "c": photos(range(12, 38)),
    }
    assert groups_by_photos(seen) == (("a", "b", "c"),)


def test_what_the_option_names() -> None:
    assert parsed_groups(["vase, tin"], BOXES) == (("vase", "tin"), ("clock",))
    assert parsed_groups(["clock", "tin,vase"], BOXES) == (("vase", "tin"), ("clock",))
    assert parsed_groups(["tin"], BOXES) == (("vase", "clock"), ("tin",))
    assert parsed_groups(["all"], BOXES) == (("vase", "tin", "clock"),)
    assert parsed_groups(["all"], ["all", "tin"]) == (("all",), ("tin",))
    assert parsed_groups(["a,b"], ["a,b", "c"]) == (("a,b",), ("c",))


@pytest.mark.parametrize(
    ("texts", "problem"),
    [
        (["vase,lamp"], "'lamp', which is no box"),
        (["vase", "tin,vase"], "'vase' twice"),
        (["vase,vase"], "'vase' twice"),
        (["all", "tin"], "all is all boxes"),
        ([","], "names no box"),
    ],
)
def test_wrong_groups_are_refused(texts: list[str], problem: str) -> None:
    with pytest.raises(ConfigError, match=problem):
        parsed_groups(texts, BOXES)


def test_the_nearest_box_decides() -> None:
    one, two = (OrientedBox.between(str(x), [x - 1, -1, -1], [x + 1, 1, 1]) for x in (0, 9))
    places = np.array([[0, 0, 0], [1, 5, 0], [4.4, 0, 0], [4.6, 0, 0], [9, 0, 3.0]])
    assert nearest_group(places, [[one], [two]]).tolist() == [0, 0, 0, 1, 1]
    assert nearest_group(places, [[one, two]]).tolist() == [0] * 5


def test_hundreds_of_boxes_that_share_photos() -> None:
    """Time grew with the cube of their number: a minute for 500."""
    names = tuple(f"box {k}" for k in range(500))
    began = time.process_time()
    assert groups_by_photos({name: {"a", "b"} for name in names}) == (names,)
    assert time.process_time() - began < 5
