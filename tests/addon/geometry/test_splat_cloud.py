"""Gaussian PLYs as the add-on reads them."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from roigs_addon.geometry.splat_cloud import read_splats, write_splats
from roigs_engine.formats.drawable import usable
from roigs_engine.formats.splat_ply import read_ply, target_of, write_ply
from roigs_engine.formats.targets import TARGETS, Target
from tests.addon.splat_cases import random_arrays, random_ply


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
def test_reads_what_the_engine_writes(tmp_path: Path, coefficients: int) -> None:
    arrays = random_arrays(50, seed=1, coefficients=coefficients)
    path = tmp_path / "Wörter und 東京.ply"
    write_ply(path, arrays)
    cloud = read_splats(path)
    assert len(cloud) == 50
    np.testing.assert_array_equal(cloud.means, arrays["means"])
    np.testing.assert_array_equal(cloud.sh, arrays["sh"])
    np.testing.assert_allclose(cloud.scales, np.exp(arrays["log_scales"]), rtol=1e-6)
    np.testing.assert_allclose(
        cloud.opacities, 1 / (1 + np.exp(-arrays["logit_opacities"])), rtol=1e-6
    )
    quats = arrays["quats"] / np.linalg.norm(arrays["quats"], axis=1, keepdims=True)
    np.testing.assert_allclose(cloud.quats, quats, rtol=1e-6)
    for name in ("means", "quats", "scales", "opacities", "sh"):
        assert getattr(cloud, name).dtype == np.float32


@pytest.mark.parametrize("target", TARGETS.values(), ids=lambda target: target.name)
def test_a_file_says_what_it_is_made_for(tmp_path: Path, target: Target) -> None:
    arrays = random_arrays(9, seed=3)
    arrays["quats"][4] = 0  # skipped
    write_ply(tmp_path / "a.ply", arrays, target)
    cloud = read_splats(tmp_path / "a.ply")
    assert len(cloud) == 8 and cloud.target == target
    write_splats(tmp_path / "b.ply", cloud)
    assert target_of(tmp_path / "b.ply") == target


def rewritten(path: Path, types: dict[str, str], drop: tuple[str, ...] = ()) -> Path:
    """The file with other types for some columns and without others, columns reversed."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    lines = head.decode().splitlines()
    names = [line.split()[2] for line in lines if line.startswith("property")]
    table = np.frombuffer(body, [(name, "<f4") for name in names])
    kept = [name for name in reversed(names) if not name.startswith(drop)] if drop else names[::-1]
    kinds = {"double": "<f8", "float32": "<f4", "float": "<f4"}
    chosen = {name: types.get(name, "float") for name in kept}
    out = np.zeros(len(table), [(name, kinds[kind]) for name, kind in chosen.items()])
    for name in kept:
        out[name] = table[name]
    header = [line for line in lines if not line.startswith("property")]
    header += ["comment columns in another order"]
    header += [f"property {kind} {name}" for name, kind in chosen.items()]
    header += ["element face 0", "property list uchar int vertex_indices", "end_header", ""]
    path.write_bytes("\r\n".join(header).encode() + out.tobytes())
    return path


@pytest.mark.parametrize("types", [{}, {"x": "double", "opacity": "float32"}])
def test_columns_are_found_by_name(tmp_path: Path, types: dict[str, str]) -> None:
    wanted = read_splats(random_ply(tmp_path / "a.ply", 20))
    found = read_splats(rewritten(random_ply(tmp_path / "b.ply", 20), types, drop=("n",)))
    for name, values in vars(wanted).items():
        np.testing.assert_array_equal(getattr(found, name), values)


def test_what_cannot_be_drawn_is_skipped(tmp_path: Path) -> None:
    arrays = random_arrays(6, seed=2)
    arrays["means"][0, 1] = np.nan
    arrays["quats"][1] = 0
    arrays["log_scales"][2, 0] = 500
    arrays["sh"][3, 4, 2] = np.inf
    write_ply(tmp_path / "a.ply", arrays)
    cloud = read_splats(tmp_path / "a.ply")
    np.testing.assert_array_equal(cloud.means, arrays["means"][4:])


def test_exact_opacities_and_sizes_are_drawn(tmp_path: Path) -> None:
    """As infinite logarithms, which programs write for opacities of 1 and flat Gaussians."""
    arrays = random_arrays(6, seed=2)
    arrays["logit_opacities"][:2] = (np.inf, -np.inf)
    arrays["log_scales"][2, 0] = -np.inf
    write_ply(tmp_path / "a.ply", arrays)
    cloud = read_splats(tmp_path / "a.ply")
    np.testing.assert_array_equal(cloud.means, arrays["means"])
    assert cloud.opacities[0] == 1 and cloud.opacities[1] < 1e-30 and cloud.scales[2, 0] < 1e-20


def test_the_viewport_shows_what_the_engine_keeps(tmp_path: Path) -> None:
    """A size that the engine leaves out as too large was shown."""
    arrays = random_arrays(6, seed=2)
    arrays["log_scales"][1, 1], arrays["means"][3, 0] = 70, 1e16
    write_ply(tmp_path / "a.ply", arrays)
    kept = usable(read_ply(tmp_path / "a.ply"))
    np.testing.assert_array_equal(read_splats(tmp_path / "a.ply").means, kept["means"])
    assert len(kept["means"]) == 4


def test_no_gaussians(tmp_path: Path) -> None:
    assert len(read_splats(random_ply(tmp_path / "a.ply", 0))) == 0


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        (b"ply", b"obj", "is not a PLY file"),
        (b"end_header", b"end_headre", "is not a PLY file"),
        (b"binary_little_endian", b"binary", "unknown format 'binary'"),
        (b"vertex 20", b"vertex 21", "truncated: it has 20 of 21"),
        (b"vertex 20", b"vertex 999999999999999999", "truncated: it has 20 of 999999999999999999"),
        (b"vertex 20", b"vertex " + b"9" * 5000, "is not a number of vertices"),
        (b"vertex 20", b"vertex many", "'many' is not a number of vertices"),
        (b"element vertex", b"element face", "has no vertex element"),
        (b"float opacity", b"float opaque", "no property opacity"),
        (b"float f_rest_44", b"float g_rest_44", "44 properties f_rest"),
        (b"float f_rest_44", b"float f_rest_45", "no property f_rest_44"),
        (b"float nx", b"list uchar int nx", "cannot read 'property list uchar int nx'"),
        (b"float nx", b"float x", "cannot read 'property float x'"),
        (b"float nx", b"quarter nx", "cannot read 'property quarter nx'"),
    ],
)
def test_one_line_says_what_is_wrong(tmp_path: Path, old: bytes, new: bytes, text: str) -> None:
    path = random_ply(tmp_path / "a.ply", 20)
    path.write_bytes(path.read_bytes().replace(old, new, 1))
    with pytest.raises(ValueError, match=text) as caught:
        read_splats(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_missing_and_empty_files(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="Cannot read"):
        read_splats(tmp_path / "nothing.ply")
    (tmp_path / "empty.ply").touch()
    with pytest.raises(ValueError, match="is empty"):
        read_splats(tmp_path / "empty.ply")


@pytest.mark.slow
def test_a_million_gaussians_in_two_seconds(tmp_path: Path) -> None:
    path = random_ply(tmp_path / "a.ply", 1_000_000)
    start = time.process_time()
    assert len(read_splats(path)) == 1_000_000
    assert time.process_time() - start < 2
