"""SOG of other programs, and files that are not what their names say.

What is read is compared with the values that the files were built of.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from roigs_engine.errors import ConfigError, RunFolderError
from roigs_engine.exchange import formats
from roigs_engine.formats.splat_ply import write_ply
from roigs_engine.formats.targets import VIEWERS
from tests.engine.exchange.foreign_checks import STEPS, converted
from tests.engine.exchange.foreign_files import COUNT, saved, values


def test_sog_that_is_not_packed(tmp_path: Path) -> None:
    pytest.importorskip("imagecodecs")
    sog = pytest.importorskip("roigs_engine.exchange.sog")
    model = {name: rows.astype(np.float32) for name, rows in values(1).items()}
    formats.write(tmp_path / "a.sog", model, target=VIEWERS)
    for name, data in sog.files_of(model, antialiased=True).items():
        saved(tmp_path / name, data)
    packed, loose = formats.read(tmp_path / "a.sog"), formats.read(tmp_path / "meta.json")
    for name in STEPS:
        np.testing.assert_array_equal(loose[name], packed[name])
    assert formats.target_of(tmp_path / "meta.json").antialiased
    assert len(converted(tmp_path, tmp_path / "meta.json")["means"]) == COUNT
    meta = (tmp_path / "meta.json").read_text()
    saved(tmp_path / "meta.json", meta.replace("means_l", "../means_l"))
    with pytest.raises(RunFolderError, match="is not below its folder"):
        formats.read(tmp_path / "meta.json")
    saved(tmp_path / "meta.json", meta.replace("means_l", "gone"))
    with pytest.raises(RunFolderError, match=r"needs gone\.webp, which cannot be read"):
        formats.read(tmp_path / "meta.json")
    saved(tmp_path / "meta.json", meta.replace('"version": 2', '"version": 3'))
    with pytest.raises(RunFolderError, match="version 3 of SOG is not supported"):
        formats.read(tmp_path / "meta.json")


@pytest.mark.parametrize("name", ["a.ksplat", "a.lcc", "a.rad", "a.b3dm", "lod-meta.json"])
def test_names_of_other_formats_are_not_supported(name: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=f"{name[-4:]} .*is not supported"):
        formats.read(saved(tmp_path / name, b"x"))


@pytest.mark.parametrize("ending", [".spz", ".sog", ".glb", ".splat", ".gltf"])
def test_a_file_of_another_name_is_not_called_damaged(ending: str, tmp_path: Path) -> None:
    if ending == ".sog":
        pytest.importorskip("imagecodecs")
    write_ply(tmp_path / "b.ply", {k: rows.astype("f4") for k, rows in values().items()})
    source = saved(tmp_path / f"a{ending}", (tmp_path / "b.ply").read_bytes())
    with pytest.raises(RunFolderError, match=r"by its content a file \.ply\. Rename it to a\.ply"):
        formats.read(source)


@pytest.mark.parametrize(
    ("start", "message"),
    [
        (b"", "is empty"),
        (b"version https://git-lfs.github.com/spec/v1", "Git LFS. Fetch the file: git lfs pull"),
        (b"\n<!DOCTYPE html>", "is a web page"),
        (b"PK\x03\x04", "is a ZIP archive"),
        (b"glTF\2\0\0\0", r"by its content a file \.glb\. Rename it"),
    ],
)
def test_what_is_no_model_is_named(start: bytes, message: str, tmp_path: Path) -> None:
    for ending in (".ply", ".gltf") if start else (".ply",):
        with pytest.raises(RunFolderError, match=message):
            formats.read(saved(tmp_path / f"a{ending}", start))


@pytest.mark.parametrize("name", ["a.gltf", "meta.json", "a.usd"])
def test_what_is_only_read_is_not_written(name: str, tmp_path: Path) -> None:
    model = {key: rows.astype(np.float32) for key, rows in values().items()}
    with pytest.raises(ConfigError, match="is read-only"):
        formats.write(tmp_path / name, model)
