"""GLBs of other programs: integers where the extension allows them, and what is not read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from roigs_engine.errors import RunFolderError
from roigs_engine.exchange import formats
from tests.engine.exchange.format_cases import arrays
from tests.fuzz.exchange import glb_of, glb_parts

NAME = "KHR_gaussian_splatting"
TYPES = {"i1": 5120, "u1": 5121, "<i2": 5122, "<u2": 5123}


@pytest.fixture
def glb(tmp_path: Path) -> Path:
    """A GLB that we wrote."""
    pytest.importorskip("pygltflib")
    formats.write(tmp_path / "a.glb", arrays())
    return tmp_path / "a.glb"


def stored_as(path: Path, name: str, kind: str, *, normalized: bool) -> None:
    """Replace an attribute's floats by integers, at the end of the binary part."""
    record, blob = glb_parts(path.read_bytes())
    accessor = record["accessors"][record["meshes"][0]["primitives"][0]["attributes"][name]]
    view = record["bufferViews"][accessor["bufferView"]]
    start = view["byteOffset"]
    values = np.frombuffer(blob[start : start + view["byteLength"]], "<f4")
    rows = values.reshape(accessor["count"], -1)
    most = np.iinfo(kind).max if normalized else 1
    rows = np.pad(rows, ((0, 0), (0, -rows.shape[1] % 4)))  # glTF aligns rows to four bytes
    data = np.round(rows * most).astype(kind)
    accessor |= {"componentType": TYPES[kind], "normalized": normalized}
    view |= {
        "byteOffset": len(blob), "byteLength": data.nbytes, "byteStride": data[0].nbytes
    }  # fmt: skip
    path.write_bytes(glb_of(record, blob + data.tobytes()))


@pytest.mark.parametrize("kind", ["i1", "<i2"])
def test_rotations_as_normalized_integers(kind: str, glb: Path) -> None:
    before = formats.read(glb)["quats"]
    stored_as(glb, f"{NAME}:ROTATION", kind, normalized=True)
    step = 1 / np.iinfo(kind).max
    np.testing.assert_allclose(formats.read(glb)["quats"], before, atol=step)


@pytest.mark.parametrize("kind", ["u1", "<u2"])
def test_opacities_as_normalized_integers(kind: str, glb: Path) -> None:
    before = formats.read(glb)["logit_opacities"]
    stored_as(glb, f"{NAME}:OPACITY", kind, normalized=True)
    after = formats.read(glb)["logit_opacities"]
    alphas = [1 / (1 + np.exp(-logit.astype(np.float64))) for logit in (after, before)]
    np.testing.assert_allclose(*alphas, atol=1 / np.iinfo(kind).max)


def test_sizes_as_plain_integers(tmp_path: Path) -> None:
    pytest.importorskip("pygltflib")
    values = arrays()
    values["log_scales"] = np.log(np.arange(1, 1201).reshape(400, 3) % 100 + 1).astype(np.float32)
    formats.write(tmp_path / "a.glb", values)
    stored_as(tmp_path / "a.glb", f"{NAME}:SCALE", "<i2", normalized=False)
    found = formats.read(tmp_path / "a.glb")["log_scales"]
    np.testing.assert_allclose(found, values["log_scales"], atol=1e-5)


def packed(record: Any) -> None:
    record["bufferViews"][0]["extensions"] = {"EXT_meshopt_compression": {"buffer": 0}}


def compressed(record: Any) -> None:
    inner = {f"{NAME}_compression_sog": {"bufferView": 0}}
    record["meshes"][0]["primitives"][0]["extensions"][NAME]["extensions"] = inner


def in_other_colours(record: Any) -> None:
    record["meshes"][0]["primitives"][0]["extensions"][NAME]["colorSpace"] = "lin_p3d65_display"


def instanced(record: Any) -> None:
    record["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {}}


def of_triangles(record: Any) -> None:
    del record["meshes"][0]["primitives"][0]["extensions"]


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (packed, "EXT_meshopt_compression is not supported"),
        (compressed, f"{NAME}_compression_sog is not supported"),
        (in_other_colours, "colour space lin_p3d65_display is not supported"),
        (instanced, "EXT_mesh_gpu_instancing is not supported"),
        (of_triangles, f"glTF without {NAME} is not supported"),
    ],
)
def test_what_is_not_read_is_said(change: Any, why: str, glb: Path) -> None:
    """Values from elsewhere were taken from the file's own, and drawn as noise."""
    record, blob = glb_parts(glb.read_bytes())
    change(record)
    glb.write_bytes(glb_of(record, blob))
    with pytest.raises(RunFolderError, match=why):
        formats.read(glb)
