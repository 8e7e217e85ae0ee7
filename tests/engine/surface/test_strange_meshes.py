"""Meshes (.glb) of somebody else: nothing in them runs, and what lies is one line."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import EpsImagePlugin

from roigs_engine.context import Context
from roigs_engine.errors import RunFolderError, Stopped
from roigs_engine.exchange.gltf import is_mesh
from roigs_engine.surface import files
from roigs_engine.surface.files import convert_mesh, page_meshes, sampled_surface
from tests.fuzz.exchange import glb_of
from tests.fuzz.meshes import PROGRAM, mesh_record, picture, repeated

READERS: tuple[Callable[[Path], object], ...] = (
    lambda path: convert_mesh(path, path.with_suffix(".stl")),
    lambda path: page_meshes(path, np.eye(4)),
    lambda path: sampled_surface(path, 10),
)


@pytest.fixture
def ran(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file that appears when Pillow starts Ghostscript, which is another program here."""
    ran, program = tmp_path / "ran", tmp_path / "bin" / "gs"
    program.parent.mkdir()
    program.write_text(f"#!/bin/sh\necho > '{ran}'\n", encoding="utf-8")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setattr(EpsImagePlugin, "gs_binary", None)
    return ran


@pytest.mark.parametrize("reader", READERS)
def test_a_picture_that_is_a_program_does_not_run(
    tmp_path: Path, ran: Path, reader: Callable[[Path], object]
) -> None:
    path = tmp_path / "a.glb"
    path.write_bytes(glb_of(*mesh_record(PROGRAM)))
    with pytest.raises(RunFolderError, match="is not a whole glTF file"):
        reader(path)
    assert not ran.exists()


@pytest.mark.parametrize("kind", [0, 2, 3])
def test_a_mesh_that_repeats_itself_is_refused_at_once(tmp_path: Path, kind: int) -> None:
    """Primitives took more than a minute and 4 GB, values without bytes all memory."""
    record, blob = mesh_record(picture())
    repeated(record, kind)
    path = tmp_path / "a.glb"
    path.write_bytes(glb_of(record, blob))
    began = time.monotonic()
    for reader in READERS:
        with pytest.raises(RunFolderError, match=r"a\.glb.*(is not a whole|not supported)"):
            reader(path)
    assert time.monotonic() - began < 10


@pytest.mark.parametrize("distinct", [False, True])
def test_primitives_that_show_large_pictures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, distinct: bool
) -> None:
    """30 materials of a file of 50 kB took 2.3 GB. One picture is opened once, many are counted."""
    record, blob = mesh_record(picture(side=3000))
    item = record["meshes"][0]["primitives"][0]
    record["meshes"][0]["primitives"] = [item | {"material": k} for k in range(4)]
    record["materials"] = [
        {"pbrMetallicRoughness": {"baseColorTexture": {"index": k}}} for k in range(4)
    ]
    record["images"] = 4 * record["images"][:1]
    record["textures"] = [{"source": k if distinct else 0} for k in range(4)]
    path, opened = tmp_path / "a.glb", Mock(wraps=files.open_picture)
    path.write_bytes(glb_of(record, blob))
    monkeypatch.setattr(files, "open_picture", opened)
    with pytest.raises(RunFolderError, match="would unpack") if distinct else nullcontext():
        page_meshes(path, np.eye(4))
    assert opened.call_count == (3 if distinct else 1)


def many_scans(count: int) -> bytes:
    """A progressive JPEG whose last scan is repeated."""
    data = picture("JPEG", progressive=True)
    return data[:-2] + data[data.rindex(b"\xff\xda") : -2] * count + data[-2:]


def test_a_texture_of_hundreds_of_scans(tmp_path: Path) -> None:
    """247 kB took 24 seconds."""
    path = tmp_path / "a.glb"
    path.write_bytes(glb_of(*mesh_record(many_scans(20))))
    convert_mesh(path, tmp_path / "b.obj")
    path.write_bytes(glb_of(*mesh_record(many_scans(300))))
    for reader in READERS:
        with pytest.raises(RunFolderError, match=r"glTF file \(a JPEG of 3\d\d scans\)"):
            reader(path)


def test_reading_a_mesh_can_be_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, goes_on = tmp_path / "a.glb", threading.Event()
    path.write_bytes(glb_of(*mesh_record(picture())))
    monkeypatch.setattr(files, "open_picture", lambda *_: goes_on.wait(60))
    context = Context(should_stop=lambda: True)
    with pytest.raises(Stopped):
        convert_mesh(path, tmp_path / "b.obj", None, context)
    goes_on.set()


def test_faces_of_vertices_that_are_not_there(tmp_path: Path) -> None:
    record, blob = mesh_record(picture())
    start = record["bufferViews"][4]["byteOffset"]
    path = tmp_path / "a.glb"
    path.write_bytes(glb_of(record, blob[:start] + b"\xff" * 4 + blob[start + 4 :]))
    for reader in READERS:
        with pytest.raises(RunFolderError, match="faces of vertices that it does not have"):
            reader(path)


@pytest.mark.parametrize("value", [-1, -100, np.nan, 2.0, 2.7, -1e30])
def test_faces_of_vertices_of_other_numbers(tmp_path: Path, value: float) -> None:
    """Negative ones counted from the end; others were another number, or a traceback."""
    record, blob = mesh_record(picture())
    kind, code = ("<i2", 5122) if isinstance(value, int) else ("<f4", 5126)
    faces = np.array([0, 2, 1, 0, 1, value, 1, 2, 3], kind).tobytes()
    start = record["bufferViews"][4]["byteOffset"]
    record["accessors"][4] |= {"componentType": code, "count": 9}
    path = tmp_path / "a.glb"
    path.write_bytes(glb_of(record, blob[:start] + faces + blob[start + len(faces) :]))
    for reader in READERS:
        with pytest.raises(RunFolderError, match="faces of vertices that it does not have"):
            reader(path)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300, 1e39])
@pytest.mark.parametrize("key", ["translation", "scale", "matrix", "nodes"])
def test_nodes_of_numbers_that_are_not_finite(tmp_path: Path, key: str, value: float) -> None:
    record, blob = mesh_record(picture())
    matrix = np.diag([1, value, 1, 1]).ravel().tolist()
    record["nodes"] = [{"mesh": 0, key: matrix if key == "matrix" else [1, value, 1]}]
    if key == "nodes":  # each is finite
        scale = [1, min(value, 1e30), 1]
        record["nodes"] = [{"children": [1], "scale": scale}, {"mesh": 0, "scale": scale}]
    path = tmp_path / "a.glb"
    path.write_bytes(glb_of(record, blob))
    for ending in (".obj", ".ply", ".stl"):
        with pytest.raises(RunFolderError, match="infinitely far away"):
            convert_mesh(path, tmp_path / f"b{ending}")
    assert [file.name for file in tmp_path.iterdir()] == ["a.glb"]


def test_meshes_are_placed_by_their_nodes(tmp_path: Path) -> None:
    record, blob = mesh_record(picture("JPEG"))
    record["nodes"] = [{"children": [1], "scale": [2, 2, 2]}, {"mesh": 0, "translation": [0, 5, 0]}]
    path = tmp_path / "a.glb"
    path.write_bytes(glb_of(record, blob))
    assert is_mesh(path) and convert_mesh(path, tmp_path / "b.obj") == 4
    lines = (tmp_path / "b.obj").read_text(encoding="utf-8").splitlines()
    found = np.array([line.split()[1:4] for line in lines if line.startswith("v ")], float)
    assert found.min(axis=0) == pytest.approx([0, 10, 0])
    assert found.max(axis=0) == pytest.approx([2, 12, 2])


@pytest.mark.parametrize(
    ("suffix", "beside"), [(".obj", "a.png"), (".obj", "a.mtl"), (".usda", "a.png")]
)
def test_files_of_others_beside_a_mesh_stay(tmp_path: Path, suffix: str, beside: str) -> None:
    if suffix == ".usda":
        pytest.importorskip("pxr")
    source, out = tmp_path / "mesh.glb", tmp_path / f"a{suffix}"
    source.write_bytes(glb_of(*mesh_record(picture())))
    (tmp_path / beside).write_text("mine")
    with pytest.raises(RunFolderError, match=f"needs {beside} beside it, which would be replaced"):
        convert_mesh(source, out)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([beside, "mesh.glb"])
    assert (tmp_path / beside).read_text() == "mine"
    (tmp_path / beside).unlink()
    convert_mesh(source, out)
    made = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    out.unlink()  # as if the process had been killed before it
    convert_mesh(source, out)
    (tmp_path / beside).write_text("mine")  # though the mesh is there
    with pytest.raises(RunFolderError, match=f"needs {beside} beside it, which would be replaced"):
        convert_mesh(source, out)
    assert (tmp_path / beside).read_text() == "mine"
    (tmp_path / beside).unlink()
    convert_mesh(source, out)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == made


def test_a_picture_that_many_primitives_show_is_hashed_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """800 primitives of one picture took minutes: each hashed all pixels."""
    trimesh = pytest.importorskip("trimesh")
    kind = trimesh.visual.material.PBRMaterial
    hashed = Mock(return_value=1)
    monkeypatch.setattr(kind, "__hash__", hashed)
    record, blob = mesh_record(picture())
    record["meshes"][0]["primitives"] *= 50
    path = tmp_path / "a.glb"
    path.write_bytes(glb_of(record, blob))
    assert files.convert_mesh(path, tmp_path / "b.obj") == 200
    assert hashed.call_count <= 1
