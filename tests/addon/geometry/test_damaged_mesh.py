"""Meshes of a run folder that somebody else has made: one line, whatever they hold."""

from __future__ import annotations

import os
import random
from pathlib import Path

import numpy as np
import pytest

from roigs_addon.geometry.glb import read_glb
from tests.addon.colmap_project import png
from tests.fuzz.damage import bytes_damaged, tree_damaged
from tests.fuzz.exchange import glb_of
from tests.fuzz.meshes import PROGRAM, mesh_record

PICTURE = png(np.full((8, 8, 3), (200, 60, 20), np.uint8))


def refused(path: Path, data: bytes) -> None:
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"is damaged, or not the mesh of a box\.$"):
        read_glb(path)


def test_a_good_one_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.glb"
    path.write_bytes(glb_of(*mesh_record(PICTURE)))
    read = read_glb(path)
    assert read.vertices.shape == (4, 3) and read.corners.shape == (4, 3)
    assert read.picture.startswith(b"\x89PNG")


def test_damage_is_one_line(tmp_path: Path) -> None:
    path, said, read = tmp_path / "a.glb", [], []
    record, blob = mesh_record(PICTURE)
    for number in range(400):
        dice = random.Random(f"mesh {number}")
        if dice.random() < 0.5:
            data = glb_of(tree_damaged(dice, record, most=3), blob)
        else:
            data = bytes_damaged(dice, glb_of(record, blob))
        path.write_bytes(data)
        try:
            read.append(read_glb(path))
        except ValueError as error:
            said.append(str(error))
    assert len(read) > 50 and len(said) > 50
    assert not any("\n" in line for line in said)
    for mesh in read:
        assert mesh.vertices.shape[1] == 3 and mesh.corners.max() < len(mesh.vertices)


def test_kinds_of_damage(tmp_path: Path) -> None:
    path = tmp_path / "a.glb"
    record, blob = mesh_record(PICTURE)
    for at, key, value in (
        (0, "type", "VEC2"),  # positions
        (2, "type", "VEC3"),  # places in the picture
        (0, "count", 10**30),
        (4, "count", 0),  # no faces
    ):
        other = {**record, "accessors": [dict(each) for each in record["accessors"]]}
        other["accessors"][at][key] = value
        refused(path, glb_of(other, blob))
    refused(path, glb_of(*mesh_record(PROGRAM)))
    deep = b'{"meshes":' + b"[" * 100_000
    refused(path, glb_of({}, b"")[:12] + len(deep).to_bytes(4, "little") + b"JSON" + deep)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
def test_a_pipe_is_refused_at_once(tmp_path: Path) -> None:
    path = tmp_path / "a.glb"
    os.mkfifo(path)
    with pytest.raises(OSError, match="Not a file"):
        read_glb(path)
