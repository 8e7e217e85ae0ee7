"""Cases of `convert`: damaged files of all formats that it reads, and files that unpack to much."""

from __future__ import annotations

import functools
import gzip
import importlib.util
import io
import json
import os
import random
import struct
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tests.engine.exchange import foreign_files
from tests.fuzz.cases import Case, write
from tests.fuzz.damage import ODD_INTEGERS, bytes_damaged, tree_damaged, words_damaged

GAUSSIANS = 40
OUT = (".ply", ".ply", ".ply", ".splat", ".spz", ".compressed.ply", ".glb")
MANY = (0, 1, 39, 41, 10**6, 10**9, 2**31 - 1, 2**32 - 1)
"""Counts that are not those of the file."""


@functools.cache
def arrays(bands: int) -> dict[str, np.ndarray]:
    """A small model."""
    dice = np.random.default_rng(bands)
    found = {
        "means": dice.normal(size=(GAUSSIANS, 3)),
        "quats": dice.normal(size=(GAUSSIANS, 4)),
        "log_scales": dice.uniform(-5, -2, (GAUSSIANS, 3)),
        "logit_opacities": dice.normal(size=GAUSSIANS),
        "sh": dice.normal(size=(GAUSSIANS, bands, 3)) * 0.3,
    }
    return {name: values.astype(np.float32) for name, values in found.items()}


@functools.cache
def good(suffix: str, bands: int, version: int = 3) -> bytes:
    """A good file."""
    from gsply.spz import read_spz, write_spz

    from roigs_engine.exchange import formats

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"a{suffix}")
        formats.write(path, arrays(bands))
        if version == 4:
            write_spz(path, read_spz(path), version=4)
        return path.read_bytes()


def converted(dice: random.Random, folder: Path, suffix: str, data: bytes, **kinds: Any) -> Case:
    """The command on these bytes."""
    source = write(folder / "in" / f"a{suffix}", data)
    out = folder / "out" / f"b{dice.choice(OUT)}"
    return Case(["convert", str(source), str(out)], **kinds)


def spz(dice: random.Random, folder: Path) -> Case:
    """SPZ of versions 1 to 3 (gzip) and 4 (zstd)."""
    bands = dice.choice((1, 4, 16))
    kind = dice.randrange(12)
    if kind >= 10:
        model = foreign_files.values(dice.randrange(5))
        more = struct.pack("<III", 0xADBE0003, dice.choice(MANY), dice.choice((*MANY, 6, 17)))
        data = foreign_files.spz(model, dice.choice((1, 2, 3, 4)), bytes_damaged(dice, more * 2))
    elif kind < 4:
        raw = bytearray(gzip.decompress(good(".spz", bands)))
        if kind == 0:
            struct.pack_into("<I", raw, 8, dice.choice(MANY))
        elif kind == 1:
            raw[dice.randrange(16)] = dice.randrange(256)
        else:
            raw = bytearray(bytes_damaged(dice, bytes(raw)))
        data = gzip.compress(bytes(raw), 1)
        if dice.random() < 0.2:  # more follows, in a part of its own
            data += gzip.compress(dice.choice((b"", b"x", bytes(1 << 20))))
    elif kind < 7:
        whole = bytearray(good(".spz", bands, version=4))
        if kind == 4:
            struct.pack_into("<I", whole, 8, dice.choice(MANY))
        elif kind == 5:
            whole[dice.randrange(32)] = dice.randrange(256)
        else:
            table = struct.unpack_from("<I", whole, 16)[0]
            at = table + 8 * dice.randrange(10)
            struct.pack_into("<Q", whole, at, dice.choice(ODD_INTEGERS) % (1 << 64))
        data = bytes(whole)
    else:
        data = bytes_damaged(dice, good(".spz", bands, version=dice.choice((3, 4))))
    return converted(dice, folder, ".spz", data)


def compressed_ply(dice: random.Random, folder: Path) -> Case:
    """Headers of compressed PLYs with other words and counts, and damaged rows."""
    data = good(".compressed.ply", dice.choice((1, 4, 16)))
    end = data.index(b"end_header\n") + len(b"end_header\n")
    head, body = data[:end].decode(), data[end:]
    kind = dice.randrange(6)
    if kind == 0:
        head = words_damaged(dice, head)
    elif kind == 1:
        head = head.replace(" 40", f" {dice.choice((*MANY, -1, '9' * 5000, 'x', ''))}")
    elif kind == 2:
        head = bytes_damaged(dice, head.encode()).decode("latin-1")
    elif kind == 3:
        body = bytes_damaged(dice, body)
    elif kind == 4:
        lines = head.split("\n")
        dice.shuffle(lines)
        head = "\n".join(lines)
    else:
        return converted(dice, folder, ".compressed.ply", bytes_damaged(dice, data))
    return converted(dice, folder, ".compressed.ply", head.encode("latin-1", "replace") + body)


def unzipped(data: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(data)) as packed:
        return {name: packed.read(name) for name in packed.namelist()}


def zipped(files: dict[str, bytes], kind: int = zipfile.ZIP_STORED) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", kind) as packed:
        for name, content in files.items():
            packed.writestr(name, content)
    return out.getvalue()


def picture(width: int, height: int) -> bytes:
    """A WebP of nothing."""
    from PIL import Image

    out = io.BytesIO()
    Image.new("RGB", (width, height)).save(out, "WEBP", lossless=True, method=0)
    return out.getvalue()


def sog(dice: random.Random, folder: Path) -> Case:
    """SOG archives with another `meta.json`, with damaged or other pictures, and damaged as a \
whole."""
    data = good(".sog", dice.choice((1, 4, 16)))
    files = unzipped(data)
    name = dice.choice(list(files))
    kind = dice.randrange(8)
    if kind < 3:
        meta = json.loads(files["meta.json"])
        meta = tree_damaged(dice, meta, most=2)
        files["meta.json"] = json.dumps(meta).encode()
    elif kind == 3:
        meta = json.loads(files["meta.json"])
        meta["count"] = dice.choice(MANY)
        files["meta.json"] = json.dumps(meta).encode()
    elif kind == 4:
        files[name] = bytes_damaged(dice, files[name])
    elif kind == 5:
        files[name] = dice.choice((b"", picture(1, 1), picture(40, 1), picture(3000, 1)))
    elif kind == 6:
        del files[name]
    if kind == 7:
        return converted(dice, folder, ".sog", bytes_damaged(dice, data))
    packing = dice.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
    return converted(dice, folder, ".sog", zipped(files, packing))


def glb_parts(data: bytes) -> tuple[Any, bytes]:
    size = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def glb_of(record: Any, blob: bytes) -> bytes:
    text = json.dumps(record).encode("utf-8", "surrogatepass")
    text += b" " * (-len(text) % 4)
    head = struct.pack("<5I", 0x46546C67, 2, 28 + len(text) + len(blob), len(text), 0x4E4F534A)
    return head + text + struct.pack("<2I", len(blob), 0x004E4942) + blob


@functools.cache
def foreign_glb() -> bytes:
    """Several nodes, SPZ inside, values that are sparse."""
    file, model = foreign_files.Gltf(), foreign_files.values(1)
    at = file.gaussians(model)
    rows, place = np.array([1, 3], "<u2").tobytes(), np.ones((2, 3), "<f4").tobytes()
    file.record["accessors"][at["POSITION"]]["sparse"] = {
        "count": 2,
        "indices": {"bufferView": file.view(rows), "componentType": 5123},
        "values": {"bufferView": file.view(place)},
    }
    file.add(at, foreign_files.own(), translation=[1, 2, 3])
    view = file.view(foreign_files.spz(model, 3))
    inner = {f"{foreign_files.NAME}_compression_spz_2": {"bufferView": view}}
    file.add({}, foreign_files.own(extensions=inner, colorSpace="lin_rec709_display"))
    file.record["nodes"].append({"children": [0], "scale": [2, 2, 2]})
    file.record["scenes"][0]["nodes"] = [2, 1]
    return file.glb()


def glb(dice: random.Random, folder: Path) -> Case:
    """GLBs with other records, damaged values, and damaged as a whole."""
    data = dice.choice((foreign_glb(), good(".glb", dice.choice((1, 4, 16)))))
    record, blob = glb_parts(data)
    kind = dice.randrange(6)
    if kind < 2:
        record = tree_damaged(dice, record, most=2)
    elif kind == 2:  # wrong in one place only, of the same type
        record = tree_damaged(dice, record, same_type=True, most=1)
    elif kind == 3:
        accessor = dice.choice(record["accessors"])
        key = dice.choice(("count", "type", "componentType", "bufferView", "byteOffset"))
        values = (*MANY, "SCALAR", "VEC3", "VEC4", 5121, 5126, -1, 3)
        accessor[key] = dice.choice(values)
    elif kind == 4:
        blob = bytes_damaged(dice, blob)
    if kind == 5:
        return converted(dice, folder, ".glb", bytes_damaged(dice, data))
    return converted(dice, folder, ".glb", glb_of(record, blob))


def beside(dice: random.Random, folder: Path) -> Case:
    """glTF with its numbers in other files, and SOG as a folder: other names, damaged files."""
    odd = (
        "",
        ".",
        "..",
        "../a.bin",
        "/etc/passwd",
        "C:\\a.bin",
        "a\0b",
        "\ud800",
        "data:,",
        "b.bin",
    )
    if dice.random() < 0.5:
        files = unzipped(good(".sog", dice.choice((1, 4, 16))))
        meta = json.loads(files["meta.json"])
        lists = [
            part["files"] for part in meta.values() if isinstance(part, dict) and "files" in part
        ]
        if dice.random() < 0.4:
            names = dice.choice(lists)
            names[dice.randrange(len(names))] = dice.choice((*odd, 1, None, [], "meta.json"))
        elif dice.random() < 0.4:
            meta = tree_damaged(dice, meta, most=2)
        files["meta.json"] = json.dumps(meta).encode()
        source = folder / "in" / "meta.json"
    else:
        record, blob = glb_parts(dice.choice((foreign_glb(), good(".glb", 4))))
        record["buffers"][0]["uri"] = "a.bin" if dice.random() < 0.5 else dice.choice(odd)
        record = record if dice.random() < 0.6 else tree_damaged(dice, record, most=2)
        files = {"a.gltf": json.dumps(record).encode(), "a.bin": blob}
        source = folder / "in" / "a.gltf"
    name = dice.choice(list(files))
    if dice.random() < 0.4:
        files[name] = bytes_damaged(dice, files[name])
    elif dice.random() < 0.1:
        del files[name]
    for each, data in files.items():
        write(folder / "in" / each, data)
    return Case(["convert", str(source), str(folder / "out" / f"b{dice.choice(OUT)}")])


def usd(dice: random.Random, folder: Path) -> Case:
    """OpenUSD as text, binary and packed."""
    suffix = dice.choice((".usda", ".usdc", ".usdc", ".usdz"))
    data = good(suffix, dice.choice((1, 4)))
    if suffix == ".usda" and dice.random() < 0.7:
        data = words_damaged(dice, data.decode()).encode()
    else:
        data = bytes_damaged(dice, data)
    return converted(dice, folder, suffix, data)


def unpacking(dice: random.Random, folder: Path) -> Case:
    """Small files that unpack to gigabytes; nothing of that size may be in memory."""
    kinds = ("gzip", "second gzip", "zstd", "zip", "zip of names", "pictures", "glb", "zeros")
    kind = dice.choice(kinds)
    if kind in ("gzip", "second gzip"):
        count = dice.choice((40_000_000, 49_999_999))
        raw = gzip.decompress(good(".spz", 1))
        head = bytearray(raw[:16])
        if kind == "second gzip":
            data = good(".spz", 1) + zeros_gzipped(1 << 30)
        else:
            struct.pack_into("<I", head, 8, count)
            data = zeros_gzipped(20 * count, bytes(head))
        return converted(dice, folder, ".spz", data, statuses=(2,))
    if kind == "zstd":
        return converted(dice, folder, ".spz", spz_of_zeros(49_999_999), statuses=(2,))
    if kind == "zeros":  # numbers that are nowhere, or shown by many nodes
        record, blob = glb_parts(good(".glb", 16))
        accessors = record["accessors"]
        if dice.random() < 0.5:
            for accessor in accessors:
                del accessor["bufferView"]
                accessor["count"] = 200_000_000
        else:
            record["nodes"] = [{"mesh": 0}] * 200_000
            record["scenes"] = [{"nodes": list(range(200_000))}]
        return converted(dice, folder, ".glb", glb_of(record, blob), statuses=(2,))
    if kind == "glb":  # one value that every attribute has, again and again
        record, blob = glb_parts(good(".glb", 16))
        count = 200_000
        record["bufferViews"][0] |= {"byteLength": 12 * count}
        record["accessors"][0] |= {"count": count}
        attributes = record["meshes"][0]["primitives"][0]["attributes"]
        attributes |= {f"_{number}": 0 for number in range(20_000)}
        data = glb_of(record, blob + bytes(12 * count))
        return converted(dice, folder, ".glb", data)
    files = unzipped(good(".sog", 1))
    if kind == "pictures":
        meta = json.loads(files["meta.json"])
        side = dice.choice((3500, 4500))
        meta["count"] = side * side
        files = dict.fromkeys(files, big_picture(side)) | {"meta.json": json.dumps(meta).encode()}
        return converted(dice, folder, ".sog", zipped(files), statuses=(2,))
    if kind == "zip":
        files["more"] = bytes(dice.choice((1 << 29, 3 << 28)))
        packed = zipped(files, zipfile.ZIP_DEFLATED)
        return converted(dice, folder, ".sog", packed, statuses=(2,))
    files |= dict.fromkeys([f"{number}.webp" for number in range(50)], bytes(1 << 24))
    return converted(dice, folder, ".sog", zipped(files, zipfile.ZIP_DEFLATED), statuses=(2,))


@functools.cache
def big_picture(side: int) -> bytes:
    return picture(side, side)


@functools.cache
def zeros_gzipped(count: int, head: bytes = b"") -> bytes:
    out = io.BytesIO()
    with gzip.GzipFile(fileobj=out, mode="wb", compresslevel=1) as packed:
        packed.write(head)
        for _ in range(count >> 20):
            packed.write(bytes(1 << 20))
        packed.write(bytes(count & ((1 << 20) - 1)))
    return out.getvalue()


@functools.cache
def spz_of_zeros(count: int) -> bytes:
    import zstandard

    parts = []
    for width in (9, 1, 3, 3, 4):
        packer = zstandard.ZstdCompressor(level=1).compressobj(size=width * count)
        pieces, left = [], width * count
        while left:
            pieces.append(packer.compress(bytes(min(left, 1 << 20))))
            left -= min(left, 1 << 20)
        parts.append(b"".join([*pieces, packer.flush()]))
    head = struct.pack("<IIIBBBBI12x", 0x5053474E, 4, count, 0, 12, 0, 5, 32)
    table = b"".join(
        struct.pack("<QQ", len(part), width * count)
        for part, width in zip(parts, (9, 1, 3, 3, 4), strict=True)
    )
    return head + table + b"".join(parts)


def misnamed(dice: random.Random, folder: Path) -> Case:
    """A file of another format, a folder, a pipe, a device, a link or nothing under each name."""
    names = (".ply", ".compressed.ply", ".spz", ".sog", ".glb", ".usda", ".usdc", ".usdz", ".splat")
    suffix = dice.choice(names)
    path = folder / "in" / f"a{suffix}"
    case = converted(dice, folder, suffix, good(dice.choice(names), 4))
    match dice.randrange(8):
        case 0:
            path.unlink()
        case 1:
            path.unlink()
            path.mkdir()
        case 2:
            path.unlink()
            os.mkfifo(path)
        case 3:
            path.unlink()
            path.symlink_to(dice.choice(("/dev/zero", "/dev/null", str(path))))
        case 4:
            path.write_bytes(b"")
    return case


def outputs(dice: random.Random, folder: Path) -> Case:
    """Everything into everything, to places that cannot be written, models out of any range."""
    bands = dice.choice((1, 4, 9, 16))
    model = {name: values.copy() for name, values in arrays(bands).items()}
    for _ in range(dice.randint(0, 3)):
        name = dice.choice(list(model))
        odd = dice.choice((np.nan, np.inf, -np.inf, 0.0, 1e-38, 1e38, -1e38, 1e5, 80.0, -200.0))
        rows = dice.choice((slice(None), slice(0, 1), slice(5, 30)))
        model[name][rows] = odd
    if dice.random() < 0.15:
        rows = dice.choice((0, 1, 2))
        model = {name: values[:rows] for name, values in model.items()}
    from roigs_engine.formats.splat_ply import write_ply

    source = folder / "in" / "a.ply"
    write_ply(source, model)
    names = (".ply", ".compressed.ply", ".spz", ".sog", ".glb", ".usda", ".usdc", ".usdz", ".splat")
    out = folder / "out" / f"b{dice.choice(names)}"
    match dice.randrange(12):
        case 0:
            out.mkdir(parents=True)
        case 1:
            write(out.parent, b"")
        case 2:
            out = out.with_name("x" * 300 + out.name)
        case 3:
            out = out.with_name("ä\n\u202e'\"" + out.name)
    more = dice.choice(([], [], ["--up", "z"], ["--sh-degree", "0"], ["--from-up", "y"]))
    return Case(["convert", str(source), str(out), *more])


# Of the extra `formats`; without them there are no good files to damage.
PACKAGES = ("gsply", "imagecodecs", "pygltflib", "pxr", "zstandard")
INSTALLED = all(importlib.util.find_spec(name) for name in PACKAGES)

FAMILIES: dict[str, tuple[Callable[[random.Random, Path], Case], int]] = (
    {
        "convert_spz": (spz, 300),
        "convert_ply": (compressed_ply, 250),
        "convert_sog": (sog, 250),
        "convert_glb": (glb, 300),
        "convert_beside": (beside, 200),
        "convert_usd": (usd, 150),
        "convert_names": (misnamed, 100),
        "convert_out": (outputs, 250),
        "convert_much": (unpacking, 21),
    }
    if INSTALLED
    else {}
)
