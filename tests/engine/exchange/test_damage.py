"""Files that are not what they promise are refused in one line, before memory is taken for them.

tests/fuzz/exchange.py has thousands of them.
"""

from __future__ import annotations

import gzip
import io
import json
import os
import struct
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import Image

from roigs_engine.cli import main
from roigs_engine.errors import EngineError
from roigs_engine.exchange import formats, gltf, gltf_file, libraries, spz
from roigs_engine.formats.splat_ply import read_ply, write_ply
from tests.fuzz import exchange
from tests.waiting import at_most

pytestmark = pytest.mark.cold


def refused(path: Path, data: bytes, said: str) -> None:
    path.write_bytes(data)
    with pytest.raises(EngineError, match=said):
        formats.read(path)


def test_gzip_that_goes_on_behind_the_model(tmp_path: Path) -> None:
    pytest.importorskip("gsply")
    more = gzip.compress(bytes(1 << 20))
    refused(tmp_path / "a.spz", exchange.good(".spz", 1) + more, "something follows")


def test_gzip_that_unpacks_to_a_thousand_times_its_size(tmp_path: Path) -> None:
    pytest.importorskip("gsply")
    head = bytearray(gzip.decompress(exchange.good(".spz", 1))[:16])
    struct.pack_into("<I", head, 8, 10_000_000)
    data = exchange.zeros_gzipped(200_000_000, bytes(head))
    refused(tmp_path / "a.spz", data, "unpack to 0.2 GB")


def test_pictures_of_nothing(tmp_path: Path) -> None:
    for package in ("gsply", "imagecodecs"):
        pytest.importorskip(package)
    files = exchange.unzipped(exchange.good(".sog", 1))
    meta = json.loads(files["meta.json"]) | {"count": 2000 * 2000}
    files = dict.fromkeys(files, exchange.big_picture(2000))
    data = exchange.zipped(files | {"meta.json": json.dumps(meta).encode()})
    refused(tmp_path / "a.sog", data, "unpack to 80 MB")


@pytest.mark.parametrize("picture", ["means_l.webp", "sh0.webp"])
def test_a_damaged_picture_is_not_a_matter_of_rights(tmp_path: Path, picture: str) -> None:
    for package in ("gsply", "imagecodecs"):
        pytest.importorskip(package)
    files = exchange.unzipped(exchange.good(".sog", 1))
    files[picture] = files[picture][:-20]
    refused(tmp_path / "a.sog", exchange.zipped(files), "is not a whole SOG file")


@pytest.mark.parametrize("count", [[1], -3, 1 << 40])
def test_a_palette_of_another_kind(tmp_path: Path, count: object) -> None:
    for package in ("gsply", "imagecodecs"):
        pytest.importorskip(package)
    files = exchange.unzipped(exchange.good(".sog", 1))
    meta = json.loads(files["meta.json"])
    meta["shN"] = {"count": count, "files": ["sh0.webp", "sh0.webp"], "codebook": [0.0] * 256}
    data = exchange.zipped(files | {"meta.json": json.dumps(meta).encode()})
    refused(tmp_path / "a.sog", data, "a palette of another kind")


def test_attributes_of_another_width(tmp_path: Path) -> None:
    pytest.importorskip("pygltflib")
    record, blob = exchange.glb_parts(exchange.good(".glb", 1))
    attributes = record["meshes"][0]["primitives"][0]["attributes"]
    attributes["KHR_gaussian_splatting:ROTATION"] = attributes["POSITION"]
    refused(tmp_path / "a.glb", exchange.glb_of(record, blob), r"do not belong together \(quats\)")


def test_a_property_without_a_name(tmp_path: Path) -> None:
    pytest.importorskip("gsply")
    data = exchange.good(".compressed.ply", 1).replace(b"property float min_x", b"property")
    refused(tmp_path / "a.compressed.ply", data, "'property'")


@pytest.mark.parametrize("suffix", [".usda", ".spz", ".glb", ".sog", ".compressed.ply"])
def test_a_folder(suffix: str, tmp_path: Path) -> None:
    (tmp_path / f"a{suffix}").mkdir()
    with pytest.raises(EngineError, match="Is a directory"):
        formats.read(tmp_path / f"a{suffix}")


def test_openusd_with_bytes_that_are_no_text(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    data = exchange.good(".usda", 1)
    refused(tmp_path / "a.usda", data[:200] + b"\xff\xe3" + data[202:], "not a whole OpenUSD")


def test_gaussians_that_cannot_be_drawn_are_left_out_when_turned(tmp_path: Path) -> None:
    """Models of other programs have some: they made the whole export fail."""
    model = {name: values.copy() for name, values in exchange.arrays(4).items()}
    model["quats"][0], model["means"][1], model["log_scales"][2] = 0, np.nan, 100
    write_ply(tmp_path / "a.ply", model)
    assert main(["convert", str(tmp_path / "a.ply"), str(tmp_path / "b.ply"), "--up", "z"]) == 0
    assert len(read_ply(tmp_path / "b.ply")["means"]) == exchange.GAUSSIANS - 3
    placed = {"models": [{"ply": str(tmp_path / "a.ply"), "matrix": np.eye(4).tolist()}]}
    (tmp_path / "list.json").write_text(json.dumps(placed))
    assert main(["convert", str(tmp_path / "list.json"), str(tmp_path / "c.ply")]) == 0
    assert len(read_ply(tmp_path / "c.ply")["means"]) == exchange.GAUSSIANS - 3


def test_places_out_of_any_range(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_ply(tmp_path / "a.ply", exchange.arrays(1))
    for matrix in (np.diag([1e300, 1e300, 1e300, 1]), np.eye(4) + 1e200 * np.eye(4, k=3)):
        placed = {"models": [{"ply": str(tmp_path / "a.ply"), "matrix": matrix.tolist()}]}
        (tmp_path / "list.json").write_text(json.dumps(placed))
        assert main(["convert", str(tmp_path / "list.json"), str(tmp_path / "c.ply")]) == 2
        assert "matrix has a number that is NaN, Inf or too large" in capsys.readouterr().err


def test_the_brightest_look_of_blender(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", exchange.arrays(1))
    placed = {"ply": str(tmp_path / "a.ply"), "matrix": np.eye(4).tolist(), "gains": [2.0**20] * 3}
    (tmp_path / "list.json").write_text(json.dumps({"models": [placed]}))
    assert main(["convert", str(tmp_path / "list.json"), str(tmp_path / "c.ply")]) == 0


def test_openusd_says_what_is_wrong_and_not_where_in_its_source(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    whole = exchange.good(".usdc", 1)
    refused(tmp_path / "a.usdc", whole[:2000], r"\(Sdf crate file corrupt, possibly truncated")
    refused(tmp_path / "b.usdc", whole[:50], r"\(File too small to contain bootstrap structure\)")
    refused(tmp_path / "c.usdz", exchange.good(".usdz", 1)[:200], "there is no layer in it")


def test_openusd_opens_no_other_file_and_nothing_twice(tmp_path: Path) -> None:
    """Doubling references of 2 KB reached 5 GB; a pipe that a layer names is waited for."""
    pytest.importorskip("pxr")
    good = exchange.good(".usda", 1).decode()
    (tmp_path / "other.usda").write_text(good)
    os.mkfifo(tmp_path / "pipe.usda")
    double = "".join(
        f'def "P{k}" {{\n def "a" (references = </P{k - 1}>) {{\n }}\n'
        f' def "b" (references = </P{k - 1}>) {{\n }}\n}}\n'
        for k in range(1, 60)
    )
    head, _, rest = good.partition("\n)\n")
    texts = {
        "doubled": f'#usda 1.0\ndef "P0" {{\n}}\n{double}',
        "referred": '#usda 1.0\ndef "A" (references = @other.usda@) {\n}\n',
        "paid": f'#usda 1.0\ndef "A" (payload = @{tmp_path}/other.usda@) {{\n}}\n',
        "layered": "#usda 1.0\n(\n subLayers = [@pipe.usda@]\n)\n",
    }
    for name, text in texts.items():
        (tmp_path / f"{name}.usda").write_text(text)
        with pytest.raises(EngineError, match="in other files, which are not opened"):
            formats.read(tmp_path / f"{name}.usda")
    (tmp_path / "good.usda").write_text(f"{head}\n subLayers = [@pipe.usda@]\n)\n{rest}")
    assert len(formats.read(tmp_path / "good.usda")["means"]) == exchange.GAUSSIANS


@pytest.mark.parametrize(
    ("head", "opening"),
    [
        ("", 'def "a" (\n doc = """}"}"""\n) { # }\n'),
        ("(customLayerData = {\n", "dictionary a = { # }}\n string b = '}'\n"),
    ],
)
def test_openusd_text_that_is_nested_too_deep(head: str, opening: str, tmp_path: Path) -> None:
    """OpenUSD's recursion ended the whole process."""
    pytest.importorskip("pxr")
    data = f"#usda 1.0\n{head}{opening * 100_000}".encode()
    refused(tmp_path / "a.usda", data, "OpenUSD cannot open it")


def test_brackets_in_words_open_nothing(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    good = exchange.good(".usda", 1).decode()
    brackets = "{" * 1000
    words = f'# {brackets}\n#usda\ndef "b" (\n doc = """{brackets}\n"{brackets}"""\n) {{\n}}\n'
    (tmp_path / "a.usda").write_text(f"{good}\n{words}")
    assert len(formats.read(tmp_path / "a.usda")["means"]) == exchange.GAUSSIANS


def test_openusd_that_is_nested_or_packed_too_far(tmp_path: Path) -> None:
    """Compressed arrays have a thousandth of their size."""
    usd, vt = pytest.importorskip("pxr.Usd"), pytest.importorskip("pxr.Vt")
    stage = usd.Stage.CreateNew(str(tmp_path / "deep.usdc"))
    stage.DefinePrim("/a" * 300)
    stage.GetRootLayer().Save()
    stage = usd.Stage.CreateNew(str(tmp_path / "packed.usdc"))
    prim = stage.DefinePrim("/G", "ParticleField3DGaussianSplat")
    prim.GetAttribute("opacities").Set(vt.FloatArray.FromNumpy(np.ones(20_000_000, np.float32)))
    stage.GetRootLayer().Save()
    for name, said in (("deep", "nested more than 200 deep"), ("packed", "unpack to far more")):
        with pytest.raises(EngineError, match=said):
            formats.read(tmp_path / f"{name}.usdc")


def test_gltf_with_every_primitive_in_every_node(tmp_path: Path) -> None:
    """120 million places of a file of 1 MB filled the memory."""
    pytest.importorskip("pygltflib")
    primitives = [{"extensions": {"KHR_gaussian_splatting": {}}}] * 300
    record = {"meshes": [{"primitives": primitives}], "nodes": [{"mesh": 0}] * 1000}
    record |= {"scenes": [{"nodes": list(range(1000))}]}
    refused(tmp_path / "a.glb", exchange.glb_of(record, b""), r"glTF with 4,200 primitives")


def test_gltf_that_names_one_file_again_and_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pygltflib")
    record, blob = exchange.glb_parts(exchange.good(".glb", 1))
    (tmp_path / "a.bin").write_bytes(blob)
    views = record["bufferViews"]
    names = ["./" * k + "a.bin" for k in range(len(views))]
    record["buffers"] = [{"uri": name, "byteLength": len(blob)} for name in names]
    record["bufferViews"] = [view | {"buffer": k} for k, view in enumerate(views)]
    (tmp_path / "a.gltf").write_text(json.dumps(record))
    read = []
    monkeypatch.setattr(gltf_file, "read_beside", lambda _, name: read.append(name) or blob)
    assert len(formats.read(tmp_path / "a.gltf")["means"]) == exchange.GAUSSIANS
    assert len(read) == 1


@pytest.mark.parametrize("names", [["a.webp", "./a.webp"], [f"{k}.webp" for k in range(50)]])
def test_sog_that_names_files_again_and_again(names: list[str], tmp_path: Path) -> None:
    for package in ("gsply", "imagecodecs"):
        pytest.importorskip(package)
    for name in names:
        (tmp_path / name).write_bytes(b"")
    data = json.dumps({"version": 2, "count": 1, "means": {"files": names}}).encode()
    refused(tmp_path / "meta.json", data, "a file under two names, or too many files")


def test_sog_with_pictures_of_another_kind(tmp_path: Path) -> None:
    for package in ("gsply", "imagecodecs"):
        pytest.importorskip(package)
    files = exchange.unzipped(exchange.good(".sog", 1))
    with Image.open(io.BytesIO(files["means_l.webp"])) as picture:
        out = io.BytesIO()
        picture.save(out, "TIFF")
    files["means_l.webp"] = out.getvalue()
    refused(tmp_path / "a.sog", exchange.zipped(files), "cannot identify image file")


@pytest.mark.parametrize("name", ["a\0.ply", "\ud800.ply", 7])
def test_a_list_with_a_name_that_is_none(name: object, tmp_path: Path) -> None:
    matrix = np.eye(4).tolist()
    (tmp_path / "a.json").write_text(json.dumps({"models": [{"ply": name, "matrix": matrix}]}))
    assert main(["convert", str(tmp_path / "a.json"), str(tmp_path / "out.ply")]) == 2


@pytest.mark.skipif(os.name != "posix", reason="files have holes there")
@pytest.mark.parametrize("suffix", [".spz", ".splat", ".glb", ".gltf", ".sog", ".usda", ".ply"])
def test_a_file_of_holes_is_not_read(suffix: str, tmp_path: Path) -> None:
    """It takes no disk, and took all of the memory."""
    path = tmp_path / f"a{suffix}"
    for head in (b"", b"x" * 5000):
        path.write_bytes(head)
        os.truncate(path, 6 << 30)
        with pytest.raises(EngineError, match="Nothing but holes"):
            formats.read(path)


def test_gltf_that_shows_one_spz_again_and_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was unpacked and moved for each node, which took half a minute, and refused then."""
    pytest.importorskip("gsply")
    raw = exchange.good(".spz", 1)
    name = "KHR_gaussian_splatting"
    packed = {f"{name}_compression_spz_2": {"bufferView": 0}}
    primitive = {"extensions": {name: {"kernel": "ellipse", "extensions": packed}}}
    record = {
        "buffers": [{"byteLength": len(raw)}],
        "bufferViews": [{"buffer": 0, "byteLength": len(raw)}],
        "meshes": [{"primitives": [primitive] * 3}],
        "nodes": [{"mesh": 0, "translation": [k, 0, 0]} for k in range(40)],
    }
    path = tmp_path / "a.glb"
    path.write_bytes(exchange.glb_of(record, raw))
    decoded, moved = Mock(wraps=spz.unpacked), Mock(wraps=gltf.moved)
    monkeypatch.setattr(spz, "unpacked", decoded)
    monkeypatch.setattr(gltf, "moved", moved)
    one = len(formats.read(path)["means"]) // 120
    assert one and (decoded.call_count, moved.call_count) == (1, 1 + 120)
    monkeypatch.setattr(libraries, "SMALL", 120 * one)
    monkeypatch.setattr(libraries, "MOST_RATIO", 1)
    with pytest.raises(EngineError, match="would unpack to"):
        formats.read(path)
    assert (decoded.call_count, moved.call_count) == (2, 1 + 120 + 1)


def test_a_sog_that_names_one_picture_again_and_again(tmp_path: Path) -> None:
    for package in ("gsply", "imagecodecs"):
        pytest.importorskip(package)
    files = exchange.unzipped(exchange.good(".sog", 1))
    meta = json.loads(files["meta.json"])
    meta["means"]["files"] += 100 * meta["means"]["files"][:1]
    data = exchange.zipped(files | {"meta.json": json.dumps(meta).encode()})
    refused(tmp_path / "a.sog", data, "names 10[0-9] pictures")


def test_gltf_of_millions_of_empty_lists(tmp_path: Path) -> None:
    """Each would take thirty times its bytes."""
    data = b'{"asset": {"version": "2.0"}, "extras": [' + b"[]," * (2_100_000)
    with at_most(5, AssertionError("it is parsed")):
        refused(tmp_path / "a.gltf", data + b"[]]}", "too many values")


def test_a_ply_of_many_elements_that_are_cut_off(tmp_path: Path) -> None:
    """Each would be looked for as often as the file has bytes."""
    whole = tmp_path / "a.ply"
    whole.write_bytes(exchange.good(".ply", 1))
    head, vertices = whole.read_bytes().split(b"end_header")[0].split(b"element vertex", 1)
    lists = b"".join(
        b"element e%d 999999999\nproperty list uchar char a\n" % k for k in range(20_000)
    )
    whole.write_bytes(head + lists + b"element vertex" + vertices + b"end_header\n" + bytes(2000))
    with at_most(5, AssertionError("it goes on")), pytest.raises(EngineError, match="cut off"):
        read_ply(whole)


def test_rows_that_an_accessor_replaces_are_counted(tmp_path: Path) -> None:
    """4,096 primitives of one such accessor took minutes."""
    rows = 1_000_000
    accessor = {"componentType": 5126, "count": 1, "type": "SCALAR"}
    places, values = ({"bufferView": k} for k in range(2))
    sparse = {"count": rows, "indices": {**places, "componentType": 5121}, "values": values}
    record = {
        "accessors": [{**accessor, "sparse": sparse}],
        "bufferViews": [{"byteLength": rows}, {"byteOffset": rows, "byteLength": 4 * rows}],
        "buffers": [{"byteLength": 5 * rows}],
    }
    path = tmp_path / "a.glb"
    path.write_bytes(exchange.glb_of(record, bytes(5 * rows)))
    file = gltf_file.GltfFile(path)
    with pytest.raises(ValueError, match="would unpack"):
        [file.rows(0) for _ in range(100)]
