"""PLY and compressed PLY of other programs: axes, line ends, what may be left out.

What is read is compared with the values that the files were built of.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from roigs_engine.errors import RunFolderError
from roigs_engine.exchange import formats
from roigs_engine.exchange.arrays import UP
from roigs_engine.formats.splat_ply import write_ply
from tests.engine.exchange.foreign_checks import STEPS, converted
from tests.engine.exchange.foreign_files import COUNT, SH_C0, saved, values


@pytest.mark.parametrize(
    ("comment", "up"), [("Vertical Axis: z", "z"), ("Vertical axis: y", "y"), ("other", "-y")]
)
@pytest.mark.parametrize("suffix", [".ply", ".compressed.ply"])
def test_ply_says_its_axis(
    comment: str, up: str, suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if suffix != ".ply":
        pytest.importorskip("gsply")
    source = tmp_path / f"a{suffix}"
    model = {name: rows.astype(np.float32) for name, rows in values().items()}
    formats.write(source, model)
    source.write_bytes(
        source.read_bytes().replace(b"\nelement", f"\ncomment {comment}\nelement".encode(), 1)
    )
    model = formats.read(source)
    found = converted(tmp_path, source, "--up=z")
    assert ("records its axes" in "".join(capsys.readouterr())) is (up != "-y")
    np.testing.assert_allclose(found["means"], model["means"] @ np.array(UP[up]), atol=1e-5)
    same = converted(tmp_path, source, "--from-up=z", "--up=z")
    np.testing.assert_allclose(same["means"], model["means"], atol=1e-5)


def test_ply_says_any_direction(tmp_path: Path) -> None:
    """Brush writes that of its training."""
    up = np.array([0.2, -0.9, 0.3])
    model = {name: rows.astype(np.float32) for name, rows in values(1).items()}
    model["means"] = np.outer(np.arange(COUNT), up).astype(np.float32)
    write_ply(tmp_path / "a.ply", model)
    text = b"\ncomment Vertical axis: 0.2 -0.9 0.3\nelement"
    saved(tmp_path / "a.ply", (tmp_path / "a.ply").read_bytes().replace(b"\nelement", text, 1))
    found = converted(tmp_path, tmp_path / "a.ply", "--up=z")["means"]
    wanted = np.outer(np.arange(COUNT) * np.linalg.norm(up), (0, 0, 1))
    np.testing.assert_allclose(found, wanted, atol=1e-5)


@pytest.mark.parametrize("degree", [0, 1])
@pytest.mark.parametrize("end", [b"\n", b"\r\n"])
def test_compressed_ply_without_bounds_of_colours(end: bytes, degree: int, tmp_path: Path) -> None:
    """As SuperSplat wrote them in its first year: colours are from 0 to 1."""
    pytest.importorskip("gsply")
    model = {name: rows.astype(np.float32) for name, rows in values(degree).items()}
    model["sh"][0, 0], model["sh"][1, 0] = -0.5 / SH_C0, 0.5 / SH_C0  # so the bounds are 0 and 1
    formats.write(tmp_path / "a.compressed.ply", model)
    wanted = formats.read(tmp_path / "a.compressed.ply")
    head, rows = (tmp_path / "a.compressed.ply").read_bytes().split(b"end_header\n", 1)
    for name in ("min_r", "min_g", "min_b", "max_r", "max_g", "max_b"):
        head = head.replace(f"property float {name}\n".encode(), b"")
    data = (head + b"end_header\n").replace(b"\n", end) + rows[:48] + rows[72:]
    found = formats.read(saved(tmp_path / "b.compressed.ply", data))
    for name in STEPS:
        np.testing.assert_allclose(found[name], wanted[name], atol=1e-6, err_msg=name)


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        (b"little", b"big", "in the format 'binary_big_endian' is not supported"),
        (b"end_header", b"element camera 0\nend_header", "element 'camera' .* is not supported"),
        (b"property float max_b\n", b"", "other properties than PlayCanvas's is not supported"),
    ],
)
def test_compressed_ply_of_other_kinds_is_named(
    old: bytes, new: bytes, why: str, tmp_path: Path
) -> None:
    """The first was read as noise."""
    pytest.importorskip("gsply")
    model = {name: rows.astype(np.float32) for name, rows in values().items()}
    formats.write(tmp_path / "a.compressed.ply", model)
    data = (tmp_path / "a.compressed.ply").read_bytes().replace(old, new, 1)
    with pytest.raises(RunFolderError, match=why):
        formats.read(saved(tmp_path / "a.compressed.ply", data))
