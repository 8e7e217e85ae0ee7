"""`levels.json`, and the rule that chooses among levels of detail."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.errors import RunFolderError
from roigs_engine.formats.levels import (
    FADE,
    Ladder,
    Level,
    rate_in_view,
    read_ladders,
    shown_levels,
    write_ladders,
)


def ladder(*farther: float, box: str = "vase") -> Ladder:
    levels = tuple(
        Level(ply=f"{k}.ply", gaussians=100 // 2**k, farther=value, measured={"psnr": 40.0})
        for k, value in enumerate((0.0, *farther))
    )
    return Ladder(box=box, rate=800.0, probes=np.zeros((1, 3)), levels=levels)


def test_it_reads_what_it_wrote(tmp_path: Path) -> None:
    written = [ladder(1.5, 3.0), ladder(box="")]
    write_ladders(tmp_path, written)
    found = read_ladders(tmp_path)
    assert list(found) == ["vase", ""]
    assert found["vase"].levels == written[0].levels
    assert found["vase"].rate == 800
    np.testing.assert_array_equal(found[""].probes, np.zeros((1, 3)))


@pytest.mark.parametrize(
    "damage",
    [
        '"version": 9',
        '"rate": 0.0',
        '"rate": NaN',
        '"probes": []',
        '"ply": "../other.ply"',
        '"ply": "/other.ply"',
        '"farther": -1.0',
        '"gaussians": "many"',
        '"levels": 3',
        '"ply": ""',
        '"ply": "rois"',
        '"ply": "a\\u0000.ply"',
        '"ply": "\\ud800.ply"',
        '"rate": 1e300',
        '"box": 5',
        '"box": "vase"',  # it is there twice
        '"farther": 1e300',
        '"farther": "x"',
    ],
)
def test_damage_is_one_line(tmp_path: Path, damage: str) -> None:
    write_ladders(tmp_path, [ladder(1.5), ladder(box="other")])
    path = tmp_path / "levels.json"
    name = damage.split(":")[0]
    lines = path.read_text().splitlines()
    row = max(i for i, line in enumerate(lines) if line.strip().startswith(name))
    key, value = lines[row].split(":", 1)
    if value.strip() in ("[", "{"):
        text = path.read_text().replace(key + ":" + value, f'{key}: 1, "was":' + value)
    else:
        lines[row] = f"{damage}," if value.rstrip().endswith(",") else damage
        text = "\n".join(lines)
    path.write_text(text)
    with pytest.raises(RunFolderError):
        read_ladders(tmp_path)


def test_levels_that_begin_too_near_each_other_are_refused(tmp_path: Path) -> None:
    write_ladders(tmp_path, [ladder(2.0, 2.1)])
    with pytest.raises(RunFolderError, match="farther must grow"):
        read_ladders(tmp_path)


@pytest.mark.parametrize("probe", [float("nan"), 1e200])
def test_a_list_without_parts_or_with_places_that_are_none_is_refused(
    tmp_path: Path, probe: float
) -> None:
    write_ladders(tmp_path, [])
    with pytest.raises(RunFolderError, match="no part"):
        read_ladders(tmp_path)
    write_ladders(tmp_path, [replace(ladder(), probes=np.full((1, 3), probe))])
    with pytest.raises(RunFolderError, match="probes"):
        read_ladders(tmp_path)


def test_rate_is_that_of_the_nearest_probes_in_the_picture() -> None:
    probes = np.array([[0, 0, z] for z in (2.0, 4.0, 8.0)] + [[50, 0, 1.0], [0, 0, -3.0]])
    to_clip = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 1, 0]])
    assert rate_in_view(probes, to_clip, 800.0) == pytest.approx(800 / 2.4)
    assert rate_in_view(probes[3:], to_clip, 800.0) == 0


def test_full_as_near_as_the_photos_and_coarser_from_afar() -> None:
    steps = ladder(2.0, 5.0)

    def names(rate: float, quality: float = 1.0) -> list[str]:
        return [level.ply for level, _ in shown_levels(steps, rate, quality)]

    assert names(800) == names(1e9) == names(401) == ["0.ply"]
    assert names(800 / (2 * FADE) - 1e-6) == ["1.ply"]
    assert names(0.001) == names(0.0) == ["2.ply"]
    assert names(200, quality=2.5) == ["0.ply"]


def test_two_in_a_fade_are_as_much_as_one_and_there_is_no_step() -> None:
    steps = ladder(2.0, 5.0)
    before: dict[str, float] = {"0.ply": 1.0}
    for coarser in np.geomspace(1.5, 8, 2000):
        now = {level.ply: density for level, density in shown_levels(steps, 800 / coarser)}
        assert sum(now.values()) == pytest.approx(1)
        for name in {*now, *before}:
            assert abs(now.get(name, 0) - before.get(name, 0)) < 0.02
        before = now
    assert before == {"2.ply": 1.0}
