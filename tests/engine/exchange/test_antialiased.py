"""Files say whether their Gaussians are drawn with anti-aliasing, as other programs say it."""

from __future__ import annotations

import gzip
import json
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.errors import ConfigError, RunFolderError
from roigs_engine.exchange import formats, spz, streamed_sog
from roigs_engine.formats.splat_ply import ANTIALIASED
from roigs_engine.formats.targets import CYCLES, PLAIN, TARGETS, VIEWERS, Target, target_with
from tests.engine.exchange.format_cases import READABLE, TOOL, arrays, needed

KEPT = [form for form in READABLE if form.keeps_antialiased]
LINE = f"{ANTIALIASED}\n".encode()
COUNT = 100


def both(folder: Path, suffix: str) -> tuple[Path, Path]:
    """The same Gaussians as a file without and one with anti-aliasing."""
    needed(formats.format_of(folder / f"a{suffix}"))
    paths = folder / f"plain{suffix}", folder / f"smooth{suffix}"
    for path in paths:
        formats.write(path, arrays(COUNT), target=target_with(antialiased=path is paths[1]))
    return paths


def zipped(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as packed:
        return {name: packed.read(name) for name in packed.namelist()}


@pytest.mark.parametrize("form", READABLE, ids=lambda form: form.suffix)
def test_it_comes_back_where_the_format_has_a_place(
    form: formats.FileFormat, tmp_path: Path
) -> None:
    plain, smooth = both(tmp_path, form.suffix)
    assert not formats.target_of(plain).antialiased
    assert formats.target_of(smooth).antialiased == form.keeps_antialiased
    found, same = formats.read(smooth), formats.read(plain)
    for name, values in same.items():
        np.testing.assert_array_equal(found[name], values)


def test_formats_with_a_place() -> None:
    assert [form.suffix for form in KEPT] == [".compressed.ply", ".ply", ".spz", ".sog"]


@pytest.mark.parametrize("suffix", [".ply", ".compressed.ply"])
def test_a_ply_has_one_more_line_after_its_format(suffix: str, tmp_path: Path) -> None:
    plain, smooth = (path.read_bytes() for path in both(tmp_path, suffix))
    assert b"comment" not in plain[:4096]
    assert smooth.startswith(b"ply\nformat binary_little_endian 1.0\n" + LINE + b"element ")
    assert smooth.replace(LINE, b"", 1) == plain


@pytest.mark.parametrize("form", READABLE, ids=lambda form: form.suffix)
@pytest.mark.parametrize("target", TARGETS.values(), ids=lambda target: target.name)
def test_targets_come_back_as_far_as_the_format_has_a_place(
    form: formats.FileFormat, target: Target, tmp_path: Path
) -> None:
    needed(form)
    path = tmp_path / f"a{form.suffix}"
    formats.write(path, arrays(COUNT), target=target)
    smooth = target.antialiased and form.keeps_antialiased
    kept = target if form.keeps_target else target_with(antialiased=smooth)
    assert formats.target_of(path) == kept
    assert len(formats.read(path)["means"]) == COUNT


def test_spz_has_one_bit_more(tmp_path: Path) -> None:
    plain, smooth = (gzip.decompress(path.read_bytes()) for path in both(tmp_path, ".spz"))
    assert [k for k in range(len(plain)) if plain[k] != smooth[k]] == [14]
    assert (plain[14], smooth[14]) == (0, 1)


def test_spz_of_version_4_is_read(tmp_path: Path) -> None:
    pytest.importorskip("zstandard")
    gsply_spz = pytest.importorskip("gsply.spz")
    made, plain, smooth = (tmp_path / f"{name}.spz" for name in ("made", "plain", "smooth"))
    formats.write(made, arrays(COUNT))
    gsply_spz.write_spz(plain, gsply_spz.read_spz(made), version=4)
    data = bytearray(plain.read_bytes())
    assert data[:4] == b"NGSP" and not formats.target_of(plain).antialiased
    data[spz.FLAGS] |= spz.ANTIALIASED
    smooth.write_bytes(data)
    assert formats.target_of(smooth).antialiased and len(formats.read(smooth)["means"]) == COUNT


def test_sog_has_one_key_more(tmp_path: Path) -> None:
    plain, smooth = map(zipped, both(tmp_path, ".sog"))
    before, after = (json.loads(files.pop("meta.json")) for files in (plain, smooth))
    assert plain == smooth
    assert "model" not in before
    assert after == before | {"model": "antialiased"}


@pytest.mark.parametrize("suffix", [".glb", ".usda", ".splat"])
def test_formats_without_a_place_stay_as_they_are(suffix: str, tmp_path: Path) -> None:
    plain, smooth = both(tmp_path, suffix)
    assert plain.read_bytes() == smooth.read_bytes()


@pytest.mark.parametrize("suffix", [".ply", ".compressed.ply"])
@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("comment antialiased 1", True),  # Postshot
        ("comment antialiased 0", False),
        ("comment SplatRenderMode: default", False),
        ("COMMENT SPLATRENDERMODE: MIP", True),
    ],
)
def test_a_ply_of_another_program(suffix: str, line: str, expected: bool, tmp_path: Path) -> None:
    _, smooth = both(tmp_path, suffix)
    smooth.write_bytes(smooth.read_bytes().replace(LINE, f"{line}\n".encode(), 1))
    assert formats.target_of(smooth).antialiased is expected
    assert suffix == ".ply" or len(formats.read(smooth)["means"]) == COUNT


def test_a_compressed_ply_of_another_name(tmp_path: Path) -> None:
    _, smooth = both(tmp_path, ".compressed.ply")
    renamed = smooth.rename(tmp_path / "b.ply")
    assert formats.target_of(renamed).antialiased
    assert len(formats.read(renamed)["means"]) == COUNT


@pytest.mark.parametrize(("flags", "expected"), [(0, False), (2, False), (3, True)])
def test_other_flags_of_spz(flags: int, expected: bool, tmp_path: Path) -> None:
    plain, _ = both(tmp_path, ".spz")
    whole = bytearray(gzip.decompress(plain.read_bytes()))
    whole[14] = flags
    plain.write_bytes(gzip.compress(whole))
    assert formats.target_of(plain).antialiased is expected
    assert len(formats.read(plain)["means"]) == COUNT


@pytest.mark.parametrize("model", ["2dgs", None, ["antialiased"]])
def test_other_models_of_sog(model: object, tmp_path: Path) -> None:
    plain, _ = both(tmp_path, ".sog")
    files = zipped(plain)
    meta = json.loads(files["meta.json"]) | {"model": model}
    with zipfile.ZipFile(plain, "w") as packed:
        for name, data in (files | {"meta.json": json.dumps(meta).encode()}).items():
            packed.writestr(name, data)
    assert not formats.target_of(plain).antialiased


@pytest.mark.parametrize("suffix", [".spz", ".sog"])
def test_a_damaged_file_is_one_line(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{suffix}"
    with pytest.raises(RunFolderError, match="Cannot read"):
        formats.target_of(path)
    for data in (b"", b"\x1f\x8b", b"\x1f\x8b" + bytes(50), b"NGSP", b"PK\x03\x04", b"PK\x05\x06"):
        path.write_bytes(data)
        with pytest.raises(RunFolderError) as caught:
            formats.target_of(path)
        assert str(path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("meta", [b"[]", b"{", b"\xff"])
def test_a_damaged_meta_json_is_one_line(meta: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.sog"
    with zipfile.ZipFile(path, "w") as packed:
        packed.writestr("meta.json", meta)
    with pytest.raises(RunFolderError, match="not a whole SOG"):
        formats.target_of(path)


def test_web_pages_are_only_written(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        formats.target_of(tmp_path / "a.html")


def test_files_that_become_one_must_agree(tmp_path: Path) -> None:
    plain, smooth = both(tmp_path, ".ply")
    targets = {path: formats.target_of(path) for path in (plain, smooth)}
    assert formats.common_target({smooth: VIEWERS, tmp_path: VIEWERS}) == VIEWERS
    assert formats.common_target({}) == PLAIN
    with pytest.raises(ConfigError, match=r"plain\.ply .* without .*smooth\.ply for Splat"):
        formats.common_target(targets)
    with pytest.raises(ConfigError, match=r"for Splat .*plain\.ply for Blender 5\.3, C"):
        formats.common_target({smooth: VIEWERS, plain: CYCLES})


def test_each_sog_of_a_streamed_one_has_the_key(tmp_path: Path) -> None:
    pytest.importorskip("sklearn")
    for antialiased, expected in ((False, None), (True, "antialiased")):
        path = tmp_path / str(antialiased) / "lod-meta.json"
        streamed_sog.write(path, [[arrays(60), arrays(20)], [arrays(60)]], antialiased=antialiased)
        names = json.loads(path.read_text())["filenames"]
        found = [json.loads((path.parent / name).read_text()).get("model") for name in names]
        assert found == [expected] * 3


@pytest.mark.skipif(TOOL is None, reason="needs npm's @playcanvas/splat-transform")
@pytest.mark.parametrize("form", KEPT, ids=lambda form: form.suffix)
def test_another_program_sees_it(form: formats.FileFormat, tmp_path: Path) -> None:
    for path, expected in zip(both(tmp_path, form.suffix), (False, True), strict=True):
        back = tmp_path / f"back{path.stem}.ply"
        subprocess.run([str(TOOL), "-q", "-w", path, back], check=True, capture_output=True)
        assert formats.target_of(back).antialiased is expected
