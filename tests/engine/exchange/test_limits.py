"""Models at the ends of what formats hold: what is written can be read, or is refused."""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from roigs_engine.cli import main
from roigs_engine.errors import ConfigError
from roigs_engine.exchange import formats
from roigs_engine.exchange.arrays import Arrays
from roigs_engine.formats.splat_ply import read_ply, write_ply
from tests.engine.exchange.format_cases import LEAST, READABLE, arrays, needed, picture, psnr


def converted(values: Arrays, form: formats.FileFormat, folder: Path, *, up: str) -> Path:
    """The file that `convert` makes of a PLY with these values."""
    write_ply(folder / "in.ply", values)
    out = folder / f"out{form.suffix}"
    assert main(["convert", str(folder / "in.ply"), str(out), f"--up={up}"]) == 0
    return out


@pytest.mark.parametrize("form", READABLE, ids=lambda form: form.suffix)
def test_the_number_that_is_said_is_that_in_the_file(
    form: formats.FileFormat, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    needed(form)
    values = arrays()
    values["means"][0, 0], values["sh"][1, 0, 0], values["quats"][2] = np.nan, np.inf, 0
    out = converted(values, form, tmp_path, up="z")
    assert capsys.readouterr().out.startswith("397 Gaussians (3 left out), ")
    assert len(formats.read(out)["means"]) == 397


@pytest.mark.parametrize("form", READABLE, ids=lambda form: form.suffix)
def test_exact_opacities_and_sizes_are_kept(
    form: formats.FileFormat, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Programs write opacities of 1 and flat Gaussians as infinite logarithms."""
    needed(form)
    values = arrays()
    values["logit_opacities"][:200] = np.inf
    values["log_scales"][:200, 2], values["log_scales"][200:210] = -np.inf, -np.inf
    values["logit_opacities"][210:220] = -np.inf
    out = converted(values, form, tmp_path, up="-y")
    assert capsys.readouterr().out.startswith("400 Gaussians, ")
    limits = {"logit_opacities": (-80, 80), "log_scales": (-60, 60)}  # far beyond all formats
    finite = {name: np.clip(a, *limits.get(name, (-np.inf, np.inf))) for name, a in values.items()}
    assert psnr(picture(finite), picture(values)) > 100
    assert main(["convert", str(out), str(tmp_path / "back.ply"), "--from-up=-y"]) == 0
    back = picture(read_ply(tmp_path / "back.ply"))
    assert psnr(back, picture(values)) > LEAST.get(form.suffix, 60.0)


def test_what_spz_leaves_out_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("gsply")
    values = arrays()
    values["means"][0] = (1e6, 0, 0)
    write_ply(tmp_path / "in.ply", values)
    for name in ("a.spz", "a.html"):
        assert main(["convert", str(tmp_path / "in.ply"), str(tmp_path / name)]) == 0
        assert capsys.readouterr().out.startswith("399 Gaussians (1 left out), ")
    assert "Loading 399 Gaussians" in (tmp_path / "a.html").read_text(encoding="utf-8")


def test_spz_without_gaussians_is_refused(tmp_path: Path) -> None:
    """It was written, and no reader took it."""
    pytest.importorskip("gsply")
    values = arrays()
    values["means"] = values["means"] * np.float32(4e6)
    for some in (values, {name: rows[:1] for name, rows in values.items()}):
        some = dict(some)
        some["means"][0] = (9e6, 0, 0)
        with pytest.raises(ConfigError, match="too large, or too far from the origin, for SPZ"):
            formats.write(tmp_path / "a.spz", some)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("scale", "offset"), [(1e-6, 0.0), (1.0, 9e3)])
def test_sog_refuses_what_its_readers_show_moved(
    scale: float, offset: float, tmp_path: Path
) -> None:
    """Positions are logarithms, which readers take the exponential of in float32."""
    needed(formats.format_of(tmp_path / "a.sog"))
    values = arrays()
    values["means"] = values["means"] * np.float32(scale) + np.float32(offset)
    values["log_scales"] += np.float32(np.log(scale))
    with pytest.raises(ConfigError, match="too small, or too far from the origin, for SOG"):
        formats.write(tmp_path / "a.sog", values)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("scale", "offset"), [(1e-3, 0.0), (1e6, 0.0), (1.0, 300.0)])
def test_sog_keeps_positions_in_other_units(scale: float, offset: float, tmp_path: Path) -> None:
    needed(formats.format_of(tmp_path / "a.sog"))
    values = arrays()
    values["means"] = values["means"] * np.float32(scale) + np.float32(offset)
    formats.write(tmp_path / "a.sog", values)
    found = np.sort(formats.read(tmp_path / "a.sog")["means"][:, 0])
    size = np.ptp(values["means"][:, 0])
    assert np.abs(found - np.sort(values["means"][:, 0])).max() < 1e-3 * size


def test_one_size_of_nothing_costs_the_others_nothing(tmp_path: Path) -> None:
    """The codebook of SOG was spread over all sizes from that one to the largest."""
    needed(formats.format_of(tmp_path / "a.sog"))
    values = arrays(2000)
    values["sh"] = values["sh"][:, :1]  # a palette takes long
    values["log_scales"][0] = -1e6
    formats.write(tmp_path / "a.sog", values)
    found = np.sort(formats.read(tmp_path / "a.sog")["log_scales"].reshape(-1))
    wanted = np.sort(values["log_scales"].reshape(-1))
    assert np.abs(found[3:] - wanted[3:]).max() < 0.05


@pytest.mark.parametrize("count", [1, 2, 255, 256, 257])
@pytest.mark.parametrize("form", READABLE, ids=lambda form: form.suffix)
def test_few_gaussians(form: formats.FileFormat, count: int, tmp_path: Path) -> None:
    needed(form)
    values = arrays(count)
    formats.write(tmp_path / f"a{form.suffix}", values)
    found = formats.read(tmp_path / f"a{form.suffix}")
    assert len(found["means"]) == count
    order, other = (np.argsort(part["means"][:, 0]) for part in (values, found))
    near = 0.01 if count > 1 else 0.05
    assert np.abs(found["means"][other] - values["means"][order])[:, 0].max() < near


def test_spz_is_what_its_header_says(tmp_path: Path) -> None:
    """Read with nothing but its specification: positions, sizes and opacities."""
    pytest.importorskip("gsply")
    values = arrays(100)
    formats.write(tmp_path / "a.spz", values)
    raw = gzip.decompress((tmp_path / "a.spz").read_bytes())
    magic, version, count, degree, bits = struct.unpack_from("<IIIBB", raw)
    assert (magic, version, count, degree) == (0x5053474E, 3, 100, 3)
    table = np.frombuffer(raw, np.uint8, 9 * count, 16).reshape(count, 3, 3).astype(np.int64)
    steps = table @ np.array([1, 1 << 8, 1 << 16])
    means = (steps - (steps >> 23 << 24)) / 2.0**bits
    far, order = cKDTree(values["means"]).query(means)
    assert far.max() < 2.0**-bits and len(set(order)) == count
    alpha = np.frombuffer(raw, np.uint8, count, 16 + 9 * count) / 255
    wanted = 1 / (1 + np.exp(-values["logit_opacities"]))
    assert np.abs(alpha - wanted[order]).max() < 0.003
    sizes = np.frombuffer(raw, np.uint8, 3 * count, 16 + 13 * count).reshape(count, 3) / 16 - 10
    assert np.abs(sizes - values["log_scales"][order]).max() < 0.04


def test_a_plain_ply_keeps_what_cannot_be_drawn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    values = arrays()
    values["means"][0, 0] = np.nan
    write_ply(tmp_path / "in.ply", values)
    assert main(["convert", str(tmp_path / "in.ply"), str(tmp_path / "out.ply")]) == 0
    assert capsys.readouterr().out.startswith("400 Gaussians, ")
    np.testing.assert_array_equal(read_ply(tmp_path / "out.ply")["means"], values["means"])


def test_spz_is_as_fine_as_an_eighth_of_a_ply_allows(tmp_path: Path) -> None:
    """A model with few view-dependent colours had the coarse steps of one with many."""
    pytest.importorskip("gsply")
    errors = []
    for spread in (0.02, 0.3):
        values = arrays(4_000)
        values["sh"][:, 1:] *= np.float32(spread / 0.12)
        formats.write(tmp_path / "a.spz", values)
        write_ply(tmp_path / "a.ply", values)
        found = formats.read(tmp_path / "a.spz")
        _, order = cKDTree(values["means"]).query(found["means"])
        errors.append(np.abs(found["sh"][:, 1:] - values["sh"][order, 1:]).mean())
        if spread == 0.02:
            assert (tmp_path / "a.ply").stat().st_size > 8 * (tmp_path / "a.spz").stat().st_size
    assert errors[0] < 1.05 / 128 and errors[1] > 2 / 128


@pytest.mark.parametrize("farthest", [15.9, 16.0, 1.0, 0.25])
def test_spz_holds_places_at_powers_of_two(farthest: float, tmp_path: Path) -> None:
    values = arrays()
    values["means"] *= np.float32(0.9 * farthest / np.abs(values["means"]).max())
    values["means"][0] = farthest, 0, 0
    values["log_scales"][:] = -9.9  # so that places need all their bits
    formats.write(tmp_path / "a.spz", values)
    back = formats.read(tmp_path / "a.spz")
    assert len(back["means"]) == len(values["means"])
    assert back["means"].max() == pytest.approx(farthest, rel=1e-5)
