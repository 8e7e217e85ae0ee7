"""Family: small files that name one thing many times, or nest it, so that reading costs far more.

Each file has about 1 MB at most. Reading takes no longer and no more memory than for other cases.
"""

from __future__ import annotations

import functools
import io
import json
import random
import sqlite3
import struct
import zlib
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path

import numpy as np
from PIL import Image

from tests.fuzz import inputs, meshes, pictures, run_folders, stores, work_folders
from tests.fuzz.cases import MODEL, Case, good_boxes, good_photos, good_scene, write, write_scene
from tests.fuzz.exchange import (
    INSTALLED,
    converted,
    foreign_glb,
    glb_of,
    glb_parts,
    unzipped,
    zipped,
)
from tests.fuzz.exchange import good as good_model
from tests.fuzz.levels_and_scribbles import CPU, run_files
from tests.fuzz.scenes import looked_at

POINTERS = (330, 34665, 34853, 40965)  # SubIFDs, Exif, GPS, interoperability
COLUMNS = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"
BIG = 3500  # pixels: the side of a picture of one colour, of some kilobytes


def many(dice: random.Random, most: int) -> int:
    """A number up to `most`, of any order of magnitude."""
    return round(10 ** dice.uniform(0, np.log10(most)))


# Photos


def pages(dice: random.Random, most: int) -> bytes:
    """A TIFF, or EXIF data, of so many bytes whose pages name one another."""
    if dice.random() < 0.3:  # one page that names itself
        count = dice.randint(1, min(most // 12 - 2, 65_000))
        entry = struct.pack("<HHII", dice.choice(POINTERS), 4, 1, 8)
        return b"II*\0" + struct.pack("<IH", 8, count) + entry * count + bytes(4)
    count = many(dice, most // (18 + 4) - 2)  # each names all, by one list
    places = [8 + 18 * number for number in range(count)]
    entry = struct.pack("<HHHII", 1, dice.choice(POINTERS), 4, count, 8 + 18 * count)
    following = [*places[1:], 0] if dice.random() < 0.5 else [0] * count
    body = b"".join(entry + struct.pack("<I", place) for place in following)
    return b"II*\0" + struct.pack("<I", 8) + body + struct.pack(f"<{count}I", *places)


def paged(dice: random.Random, folder: Path) -> Case:
    """TIFFs and photos with EXIF data whose pages name one another."""
    if dice.random() < 0.5:
        return pictures.shown(dice, folder, {"a": pages(dice, 900_000)})
    out, kind = io.BytesIO(), dice.choice(("JPEG", "PNG", "WEBP"))
    exif = b"Exif\0\0" + pages(dice, 65_000 if kind == "JPEG" else 500_000)
    Image.fromarray(pictures.SLOPE).save(out, kind, exif=exif)
    return pictures.shown(dice, folder, {"a": out.getvalue()})


def profiled(dice: random.Random, folder: Path) -> Case:
    """Photos with a profile whose tags share their data."""
    base = dice.choice(pictures.profiles())
    (count,) = struct.unpack_from(">I", base, 128)
    more, packed = many(dice, 20_000), dice.random() < 0.5  # zeros, which a PNG packs
    shared, moved = bytes(dice.choice((10**5, 10**6, 10**7)) if packed else 500_000), 12 * more
    size = len(base) + moved + len(shared)
    tags = [struct.unpack_from(">4sII", base, 132 + 12 * number) for number in range(count)]
    rows = [struct.pack(">4sII", tag, at + moved, length) for tag, at, length in tags]
    extra = [struct.pack(">4sII", b"%04d" % (k % 9999), 4 * k, size - 4 * k) for k in range(more)]
    head = struct.pack(">I", size) + base[4:128] + struct.pack(">I", count + more)
    icc = head + b"".join(rows + extra) + base[132 + 12 * count :] + shared
    out = io.BytesIO()
    if not packed and pictures.INSTALLED:
        import tifffile

        tifffile.imwrite(out, pictures.SLOPE.astype("u2") * 257, photometric="rgb", iccprofile=icc)
    else:
        Image.fromarray(pictures.SLOPE).save(out, "PNG", icc_profile=icc)
    return pictures.shown(dice, folder, {"a": out.getvalue()})


def metadata(dice: random.Random, folder: Path) -> Case:
    """Photos with very many segments or chunks, long EXIF data, or tags of very many numbers."""
    count, out = many(dice, 250_000), io.BytesIO()
    kind = dice.choice(("JPEG", "PNG", "TIFF"))
    Image.fromarray(pictures.SLOPE).save(out, kind)
    data = out.getvalue()
    if kind == "JPEG":
        long = b"\xff\xe1\xff\xff" + b"Exif\0\0".ljust(65_533, b"\1")
        part = dice.choice((b"\xff\xfe\0\2", b"\xff", b"\xff\xd0", b"\xff\xe1\0\2", long))
        data = data[:2] + part * min(count, 1_000_000 // len(part)) + data[2:]
    elif kind == "PNG":
        at = data.index(dice.choice((b"IDAT", b"IEND"))) - 4
        long = dice.choice((b"teXt", b"eXIf", b"iTXt"))
        part = struct.pack(">I4sI", 0, long, zlib.crc32(long))
        data = data[:at] + part * min(count, 1_000_000 // len(part)) + data[at:]
    else:
        (at,) = struct.unpack_from("<4xI", data)
        (rows,) = struct.unpack_from("<H", data, at)
        code, numbers, width = dice.choice(((282, 5, 8), (273, 5, 8), (40000, 3, 2), (700, 1, 1)))
        entry = struct.pack("<HHII", code, numbers, min(count, 900_000 // width), len(data))
        own = struct.pack("<H", rows + 1) + data[at + 2 : at + 2 + 12 * rows] + entry + bytes(4)
        body = data + bytes(900_000)
        data = body[:4] + struct.pack("<I", len(body)) + body[8:] + own
    return pictures.shown(dice, folder, {"a": data})


# Files of Gaussians and meshes


def values(dice: random.Random, folder: Path) -> Case:
    """A glTF whose record has very many values."""
    record, blob = glb_parts(good_model(".glb", 1))
    record["buffers"][0]["uri"] = "a.bin"
    write(folder / "in" / "a.bin", blob)
    text = json.dumps(record | {dice.choice(("extras", "nodes", "skins", "buffers")): "HERE"})
    part = dice.choice(("[]", "{}", "1", "null", '""', "[[]]", '{"mesh":0}', '{"children":[0]}'))
    text = text.replace('"HERE"', f"[{','.join([part] * many(dice, 1_000_000 // len(part)))}]")
    return converted(dice, folder, ".gltf", text.encode())


@functools.cache
def large_picture() -> bytes:
    return meshes.picture("PNG", BIG)


def repeated(dice: random.Random, folder: Path) -> Case:
    """Meshes whose primitives, materials, pictures or nodes repeat."""
    record, blob = meshes.mesh_record(large_picture())
    primitive, count = record["meshes"][0]["primitives"][0], many(dice, 5_000)
    kind = dice.randrange(4)
    record["meshes"][0]["primitives"] = [primitive | {"material": k} for k in range(count)]
    if kind == 0:
        record["materials"] *= count
    elif kind == 1:
        names = range(count)
        record["materials"] = [
            {"pbrMetallicRoughness": {"baseColorTexture": {"index": k}}} for k in names
        ]
        record["textures"] = [{"source": k} for k in names]
        record["images"] *= count
    elif kind == 2:
        record["materials"] *= count
        record["nodes"] = [{"children": [*range(1, count + 1)]}, *([{"mesh": 0}] * count)]
    else:
        record["meshes"][0]["primitives"] = [primitive] * count
        record["scenes"][0]["nodes"] *= many(dice, 200_000)
    source = write(folder / "in" / "a.glb", glb_of(record, blob))
    return Case(["convert", str(source), str(folder / "out" / f"b{dice.choice(meshes.OUT[:4])}")])


def sparse(dice: random.Random, folder: Path) -> Case:
    """glTF whose accessors replace rows, again and again."""
    rows, count = many(dice, 60_000), many(dice, 4_000)
    if mesh := dice.random() < 0.5:
        record, blob = meshes.mesh_record(meshes.picture())
    else:
        record, blob = glb_parts(foreign_glb())
    views, blob = record["bufferViews"], blob + bytes(-len(blob) % 4)
    for size in (rows, 12 * rows):
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": size})
        blob += bytes(size + -size % 4)
    record["buffers"][0]["byteLength"] = len(blob)
    primitives = record["meshes"][0]["primitives"]
    place = record["accessors"][primitives[0]["attributes"]["POSITION"]]
    places, numbers = ({"bufferView": len(views) - back} for back in (2, 1))
    place["sparse"] = {
        "count": rows, "indices": {**places, "componentType": 5121}, "values": numbers,
    }  # fmt: skip
    primitives *= count
    data = glb_of(record, blob)
    if mesh:
        source = write(folder / "in" / "a.glb", data)
        return Case(["convert", str(source), str(folder / "out" / "b.obj")])
    return converted(dice, folder, ".glb", data)


def ply(dice: random.Random, folder: Path) -> Case:
    """PLYs with many elements, properties, empty lists, empty rows, or a long header."""
    before = more = ""
    body, form = bytes(56), "binary_little_endian"
    lists = "property list uchar uchar "
    match dice.randrange(7):
        case 0:
            count = many(dice, 15_000)
            before = "".join(f"element e{k} {10**6}\n{lists}a\n" for k in range(count))
            body = bytes(500_000)
        case 1:
            before = "element e 900000000\n" + "".join(
                f"{lists}a{k}\n" for k in range(many(dice, 15_000))
            )
            body = bytes(500_000)
        case 2:
            more = "".join(f"property uchar a{k}\n" for k in range(many(dice, 40_000)))
            body = bytes(500_000)
        case 3:
            more = "".join(f"{lists}a{k}\n" for k in range(many(dice, 20_000)))
            body = bytes(500_000)
        case 4:
            form, body = "ascii", dice.choice((b"\n", b" \n", b"0 ", b"0\n")) * 400_000
        case 5:
            line = dice.choice(("comment up_axis z\n", "obj_info x\n", "comment \n"))
            before = line * many(dice, 50_000)
        case _:
            before = f"comment {'x ' * many(dice, 400_000)}\n"
            before += "".join(f"element e{k} 0\n" for k in range(many(dice, 9_000)))
    properties = "".join(f"property float {name}\n" for name in COLUMNS.split())
    count = dice.choice((1, 1, 10**9))
    head = f"ply\nformat {form} 1.0\n{before}element vertex {count}\n{properties}{more}end_header\n"
    if dice.random() < 0.3:
        return Case(["splats", str(write(folder / "in" / "a.ply", head.encode() + body))])
    return converted(dice, folder, ".ply", head.encode() + body)


def sog(dice: random.Random, folder: Path) -> Case:
    """SOGs whose `meta.json` names one picture again and again, or has very many numbers."""
    files = unzipped(good_model(".sog", dice.choice((1, 4))))
    meta = json.loads(files["meta.json"])
    parts = [part for part in meta.values() if isinstance(part, dict) and "files" in part]
    part = dice.choice(parts)
    key = dice.choice([key for key, found in part.items() if isinstance(found, list)])
    part[key] = (part[key] * many(dice, 60_000))[:60_000]
    files["meta.json"] = json.dumps(meta).encode()
    return converted(dice, folder, ".sog", zipped(files))


def levels(dice: random.Random, folder: Path) -> Case:
    """A run whose `levels.json` names one file as very many levels."""
    files = dict(run_files())
    tree = json.loads(files["levels.json"])
    for part in tree["parts"]:
        first, count = part["levels"][0], many(dice, 1_000)
        part["levels"] = [first, *(first | {"farther": 1.01**k} for k in range(1, count))]
    files["levels.json"] = json.dumps(tree).encode()
    for name, data in files.items():
        write(folder / "out" / name, data)
    model = str(folder / "out" / "result.ply")
    if dice.random() < 0.2:
        return Case(["convert", model, str(folder / "out" / "streamed" / "lod-meta.json")])
    path = str(write(folder / "in" / "path.json", json.dumps(inputs.camera_path())))
    line = ["render", model, "--path", path, "--levels", *CPU, "--out", str(folder / "out" / "p")]
    return Case(line)


# Text, records, databases, strokes


def nested(dice: random.Random, folder: Path) -> Case:
    """JSON that is nested about as deep as Python's stack allows, or far deeper."""
    depth = dice.choice((dice.randint(10, 2_000), dice.randint(900, 1_000), many(dice, 150_000)))
    opened, closed = dice.choice((("[", "]"), ('{"a":', "}"), ('[{"a":', "}]")))
    deep = opened * depth + "1" + closed * depth
    kind = dice.choice(("rois", "path", "state", "gltf", "levels", "commit", "stage"))
    if kind == "commit":
        for name, data in stores.published().items():
            body = json.loads(data) | {"gone": "HERE"} if "/.commits/" in name else None
            data = json.dumps(body).replace('"HERE"', deep).encode() if body else data
            write(folder / "out" / "runs" / name, data)
        return stores.on_store(folder, "fetch", folder / "out" / "runs", (0, 0, "", ""))
    if kind == "stage":
        files = dict(run_folders.run_files())
        name = dice.choice([name for name in files if name.endswith(".json")])
        files[name] = files[name].rstrip()[:-1] + f', "more": {deep}}}'.encode()
        return run_folders.resumed(dice, folder, files)
    text = dice.choice((deep, f'{{"version": 1, "more": {deep}}}', f"[{deep}, {deep}]"))
    if kind == "rois":
        scene, path = good_scene(folder), write(folder / "in" / "rois.json", text)
        return Case(["inspect", str(scene), "--rois", str(path)])
    if kind == "state":
        write(folder / "out" / "scene" / "reconstruction" / "state.json", text)
        write(folder / "in" / "photos" / "a.png", good_photos()[inputs.NAMES[0]])
        return Case(["resume", str(folder / "out" / "scene")])
    if kind == "gltf":
        return converted(dice, folder, ".gltf", f'{{"asset": {{}}, "extras": {deep}}}'.encode())
    files = run_files() | ({"levels.json": text.encode()} if kind == "levels" else {})
    for name, data in files.items():
        write(folder / "out" / name, data)
    cameras = json.dumps(inputs.camera_path()) if kind == "levels" else text
    path = write(folder / "in" / "path.json", cameras)
    line = ["render", str(folder / "out" / "result.ply"), "--path", str(path), "--levels", *CPU]
    return Case([*line, "--out", str(folder / "out" / "p")])


def text_model(dice: random.Random, folder: Path) -> Case:
    """Text models with a very long line, or very many short ones."""
    files = inputs.text_files(MODEL)
    name = dice.choice(list(files))
    word = dice.choice((b"1 ", b"\n", b"#\n", b"1\n", b"0 0 -1 ", b"a", b" \r\n", b"1 1 1 1 1\n"))
    more = word * many(dice, 1_000_000 // len(word))
    data = files[name]
    files[name] = dice.choice((data + more, more + data, data.rstrip(b"\n") + b" " + more))
    write_scene(folder / "in", files, good_photos())
    return Case(looked_at(dice, folder))


def computed(dice: random.Random, folder: Path) -> Case:
    """A database of COLMAP's with columns, checks and indices that compute much."""
    size = many(dice, 10**9)
    much = dice.choice((f"zeroblob({size})", f"printf('%{size}d', 1)", f"hex(zeroblob({size}))"))
    table = dice.choice(("images", "keypoints", "descriptors", "two_view_geometries"))
    damage = dice.choice((
        f"ALTER TABLE {table} ADD COLUMN more AS ({much})",
        f"CREATE INDEX i ON {table} (length({much}))",
        f"CREATE TABLE t (a INTEGER CHECK (length({much}) > 0))",
        f"ALTER TABLE {table} RENAME TO t; CREATE VIEW {table} AS SELECT *, {much} FROM t",
        "; ".join(f"CREATE TABLE t{k} (a)" for k in range(many(dice, 100))),
    ))  # fmt: skip
    write(folder / "in" / "photos" / "a.png", good_photos()[inputs.NAMES[0]])
    out = folder / "out" / "scene"
    out.mkdir(parents=True)
    work_folders.write_database(dice, out / "database.db")
    with suppress(sqlite3.Error), closing(sqlite3.connect(out / "database.db")) as file:
        file.executescript(damage)  # of a file that may be damaged already
    return Case(["resume", str(out)])


def strokes(dice: random.Random, folder: Path) -> Case:
    """Strokes of very many points, or very many strokes, some of them wide."""
    points = [[dice.randrange(24), dice.randrange(18)] for _ in range(50)]
    count, width = many(dice, 1_500), dice.choice((0.5, 4, 40, 3e4))
    one = {"kind": "object", "width": width, "points": points * count}
    several = [one | {"points": points[:2]}] * count
    drawn = dice.choice(([one], several, [one | {"kind": "background"}, *several[:500]]))
    tree = {"scribbles": [{"box": "thing", "photo": inputs.NAMES[0], "strokes": drawn}]}
    path = write(folder / "in" / "strokes.json", json.dumps(tree, separators=(",", ":")))
    line = ["masks", str(good_scene(folder)), "--rois", good_boxes(folder)]
    return Case([*line, "--scribbles", str(path), "--out", str(folder / "out"), *CPU])


Kind = Callable[[random.Random, Path], Case]
KINDS: tuple[Kind, ...] = (
    *(
        paged,
        profiled,
        metadata,
        values,
        repeated,
        sparse,
        ply,
        sog,
        levels,
        nested,
        text_model,
        computed,
    ),
    strokes,
)


def amplified(dice: random.Random, folder: Path) -> Case:
    """One of the kinds; no file of it has more than some 1 MB."""
    return dice.choice(KINDS)(dice, folder)


FAMILIES: dict[str, tuple[Kind, int]] = {"amplified": (amplified, 200)} if INSTALLED else {}
