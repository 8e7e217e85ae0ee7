"""SPZ of other programs: versions, axes, extensions, padding.

What is read is compared with the values that the files were built of.
"""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.errors import RunFolderError
from roigs_engine.exchange import formats
from tests.engine.exchange.foreign_checks import STEPS, assert_holds, converted, with_zstd
from tests.engine.exchange.foreign_files import COUNT, record, saved, spz, values

SYSTEMS = (
    *("LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF"),
    *("LFD", "RFD", "LFU", "RFU", "LBD", "RBD", "LBU", "RBU"),
)


@pytest.mark.parametrize("degree", range(5))
@pytest.mark.parametrize("version", [1, 2, 3, 4])
def test_spz_of_all_versions_and_degrees(version: int, degree: int, tmp_path: Path) -> None:
    with_zstd(version)
    model = values(degree)
    assert_holds(saved(tmp_path / "a.spz", spz(model, version)), model, STEPS)


ORBIT = record(0xADBE0002, struct.pack("<3f", -0.5, 1.2, 0.3))
PLACE = record(0x4E530001, bytes(90))


@pytest.mark.parametrize("version", [2, 3, 4])
@pytest.mark.parametrize("cut", [b"", b"\x01\x02", record(9, b"")[:6], struct.pack("<II", 9, 99)])
def test_spz_with_unknown_extensions(version: int, cut: bytes, tmp_path: Path) -> None:
    """Also one that is cut off at the end, which the format's own reader ignores."""
    with_zstd(version)
    model = values(1)
    data = spz(model, version, ORBIT + PLACE + record(0xDEAD0001, b"") + cut)
    assert_holds(saved(tmp_path / "a.spz", data), model, STEPS)
    assert (formats.frame(tmp_path / "a.spz") == np.eye(4)).all()


@pytest.mark.parametrize("number", range(1, 17))
@pytest.mark.parametrize("version", [3, 4])
def test_spz_says_its_coordinate_system(version: int, number: int, tmp_path: Path) -> None:
    """A point that is 1 right, 2 up and 3 in front is there in a PLY, of which y points down."""
    with_zstd(version)
    model = values(1)
    place = {"R": 1.0, "L": -1.0, "U": 2.0, "D": -2.0, "F": 3.0, "B": -3.0}
    model["means"][:] = [place[letter] for letter in SYSTEMS[number - 1]]
    said = ORBIT + record(0xADBE0003, struct.pack("<I", number))
    source = saved(tmp_path / "a.spz", spz(model, version, said))
    found = converted(tmp_path, source)
    np.testing.assert_allclose(found["means"], np.tile([1, -2, 3], (COUNT, 1)), atol=1e-3)


def test_spz_from_a_left_handed_system_is_mirrored_as_a_whole(tmp_path: Path) -> None:
    """Rotations and colours go with the positions: as from the mirrored model, right-handed."""
    model = values(3)
    mirrored = {name: rows.copy() for name, rows in model.items()}
    mirrored["means"][:, 0] *= -1
    mirrored["quats"][:, 2:] *= -1  # about y and z
    odd_in_x = [3, 4, 7, 10, 13, 15]
    mirrored["sh"][:, odd_in_x] *= -1
    said = record(0xADBE0003, struct.pack("<I", SYSTEMS.index("LUB") + 1))
    left = converted(tmp_path, saved(tmp_path / "a.spz", spz(model, 3, said)))
    right = converted(tmp_path, saved(tmp_path / "b.spz", spz(mirrored, 3)))
    for name in ("means", "sh"):
        np.testing.assert_allclose(left[name], right[name], atol=0.02, err_msg=name)
    covariances = [_covariances(found) for found in (left, right)]
    np.testing.assert_allclose(*covariances, atol=0.02)


def _covariances(model: dict[str, np.ndarray]) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    axes = Rotation.from_quat(np.roll(model["quats"], -1, axis=1)).as_matrix()
    axes = axes * np.exp(model["log_scales"])[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


def test_the_option_wins_over_what_the_file_says(tmp_path: Path) -> None:
    said = record(0xADBE0003, struct.pack("<I", SYSTEMS.index("RDF") + 1))
    model = values()
    source = saved(tmp_path / "a.spz", spz(model, 3, said))
    raw = converted(tmp_path, source, "--from-up=y", "--up=y")
    np.testing.assert_allclose(raw["means"], model["means"], atol=1e-3)
    with pytest.raises(RunFolderError, match="coordinate system 17 of SPZ is not supported"):
        formats.frame(saved(source, spz(model, 3, record(0xADBE0003, struct.pack("<I", 17)))))
    unsaid = record(0xADBE0003, struct.pack("<I", 0))
    assert (formats.frame(saved(source, spz(model, 3, unsaid))) == np.eye(4)).all()


@pytest.mark.parametrize("version", [3, 4])
def test_spz_without_gaussians_is_whole(version: int, tmp_path: Path) -> None:
    with_zstd(version)
    none = {name: rows[:0] for name, rows in values(1).items()}
    with pytest.raises(RunFolderError, match="has no Gaussians that can be drawn"):
        formats.read(saved(tmp_path / "a.spz", spz(none, version)))


def test_spz_of_the_future_is_not_called_damaged(tmp_path: Path) -> None:
    whole = bytearray(gzip.decompress(spz(values(), 3)))
    struct.pack_into("<I", whole, 4, 5)
    source = saved(tmp_path / "a.spz", gzip.compress(bytes(whole)))
    with pytest.raises(RunFolderError, match="version 5 of SPZ is not supported"):
        formats.read(source)


def test_zeros_after_an_spz_are_padding(tmp_path: Path) -> None:
    model = values(0)
    whole = spz(model, 3)
    found = formats.read(saved(tmp_path / "a.spz", whole + bytes(64)))
    assert len(found["means"]) == len(model["means"])
