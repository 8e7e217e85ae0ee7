"""The 3DGS PLY: bit for bit there and back, tolerant of what other tools write, clear refusals."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roigs_engine.errors import RunFolderError, Stopped
from roigs_engine.formats import ply_rows
from roigs_engine.formats.splat_ply import read_ply, target_of, up_axis, write_ply
from roigs_engine.formats.targets import EEVEE, PLAIN, TARGETS, VIEWERS, Target
from roigs_engine.model.gaussians import NAMES, Gaussians
from tests.engine.formats.gaussian_arrays import arrays


def write_foreign(
    path: Path,
    values: dict[str, np.ndarray],
    form: str = "binary_little_endian",
    kinds: dict[str, tuple[str, str]] | None = None,
) -> None:
    """A PLY whose columns are `values`, in their order, float unless `kinds` says otherwise."""
    kinds = kinds or {}
    count = len(next(iter(values.values())))
    lines = ["ply", f"format {form} 1.0", "comment by another tool", f"element vertex {count}"]
    lines += [f"property {kinds.get(name, ('float', ''))[0]} {name}" for name in values]
    dtype = np.dtype([(name, kinds.get(name, ("", "<f4"))[1]) for name in values])
    table = np.zeros(count, dtype)
    for name, column in values.items():
        table[name] = column
    header = "\n".join([*lines, "end_header", ""]).encode()
    path.write_bytes(header + table.tobytes())


def columns(model: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The content of the columns by the layout, written independently of the writer."""
    out = {axis: model["means"][:, k] for k, axis in enumerate("xyz")}
    out |= {f"f_dc_{k}": model["sh"][:, 0, k] for k in range(3)}
    higher = model["sh"].shape[1] - 1
    for channel in range(3):
        for band in range(higher):
            out[f"f_rest_{channel * higher + band}"] = model["sh"][:, 1 + band, channel]
    out["opacity"] = model["logit_opacities"]
    out |= {f"scale_{k}": model["log_scales"][:, k] for k in range(3)}
    return out | {f"rot_{k}": model["quats"][:, k] for k in range(4)}


def assert_same(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> None:
    assert set(a) == set(b) == set(NAMES)
    for name in NAMES:
        assert a[name].shape == b[name].shape
        assert a[name].dtype == b[name].dtype == np.float32
        assert a[name].tobytes() == b[name].tobytes()


@settings(max_examples=25)
@given(st.integers(0, 30), st.sampled_from([1, 4, 9, 16]), st.integers(0, 2**32 - 1))
def test_round_trip_is_bit_exact(
    tmp_path_factory: pytest.TempPathFactory, count: int, bands: int, seed: int
) -> None:
    path = tmp_path_factory.mktemp("ply") / "a b ż.ply"
    model = arrays(count, bands, seed)
    write_ply(path, model)
    assert_same(model, read_ply(path))


def test_odd_floats_survive(tmp_path: Path) -> None:
    model = arrays()
    model["means"][0] = [np.nan, np.inf, -0.0]
    model["sh"][1, 3] = np.float32(1e-42)
    write_ply(tmp_path / "m.ply", model)
    assert_same(model, read_ply(tmp_path / "m.ply"))


def test_layout_is_the_one_that_viewers_read(tmp_path: Path) -> None:
    model = arrays()
    write_ply(tmp_path / "m.ply", model)
    data = (tmp_path / "m.ply").read_bytes()
    header, rows = data.split(b"end_header\n", 1)
    names = [line.split()[2] for line in header.decode().splitlines() if "property" in line]
    wanted = ["x", "y", "z", "nx", "ny", "nz", *(f"f_dc_{k}" for k in range(3))]
    wanted += [f"f_rest_{k}" for k in range(45)]
    wanted += ["opacity", *(f"scale_{k}" for k in range(3)), *(f"rot_{k}" for k in range(4))]
    assert names == wanted
    table = np.frombuffer(rows, "<f4").reshape(7, 62)
    for name, column in columns(model).items():
        assert np.array_equal(table[:, names.index(name)], column), name


@pytest.mark.parametrize("bands", [1, 4, 9, 16])
def test_files_without_normals_and_with_fewer_bands(tmp_path: Path, bands: int) -> None:
    model = arrays(bands=bands)
    write_foreign(tmp_path / "m.ply", columns(model))
    assert_same(model, read_ply(tmp_path / "m.ply"))


def test_properties_in_any_order_with_others_between(tmp_path: Path) -> None:
    model = arrays()
    shuffled = columns(model)
    names = list(shuffled)
    np.random.default_rng(1).shuffle(names)
    mixed = {"red": np.arange(7), **{name: shuffled[name] for name in names}}
    mixed["label"] = np.arange(7)
    kinds = {"red": ("uchar", "u1"), "label": ("int", "<i4")}
    write_foreign(tmp_path / "m.ply", mixed, kinds=kinds)
    assert_same(model, read_ply(tmp_path / "m.ply"))


def test_windows_line_ends_and_a_later_element(tmp_path: Path) -> None:
    model, path = arrays(), tmp_path / "m.ply"
    write_foreign(path, columns(model))
    header, rows = path.read_bytes().split(b"end_header\n", 1)
    extra = b"element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    path.write_bytes((header + extra).replace(b"\n", b"\r\n") + rows + b"\x00")
    assert_same(model, read_ply(path))


def refused(path: Path) -> str:
    with pytest.raises(RunFolderError) as caught:
        read_ply(path)
    assert "\n" not in str(caught.value)
    assert path.name in str(caught.value)
    return str(caught.value)


def test_truncated_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.ply"
    write_ply(path, arrays())
    path.write_bytes(path.read_bytes()[:-5])
    assert "6 of 7" in refused(path)


@pytest.mark.parametrize("name", ["camera", "zz"])
@pytest.mark.parametrize("form", ["binary_little_endian", "binary_big_endian", "ascii"])
def test_forms_orders_and_elements_of_other_programs(tmp_path: Path, form: str, name: str) -> None:
    """Columns in any order, with others, doubles and lists before and behind the vertices."""
    model, path = arrays(), tmp_path / "m.ply"
    values = dict(sorted(columns(model).items(), reverse=True)) | {name: np.arange(7)}
    order = ">" if form == "binary_big_endian" else "<"
    kinds = {"opacity": ("double", f"{order}f8"), name: ("uchar", "u1")}
    kinds |= {key: ("float", f"{order}f4") for key in values if key not in kinds}
    write_foreign(path, values, form, kinds)
    head, rows = path.read_bytes().split(b"end_header\n", 1)
    before = b"element ground 2\nproperty list uchar short k\nproperty uchar c\nelement e 1\n"
    before += b"property double d\nelement vertex"
    behind = b"element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    first = b"\x02" + bytes(4) + b"\x07" + b"\x00\x08" + bytes(8)
    if form == "ascii":
        table = np.frombuffer(rows, [(key, kinds[key][1]) for key in values])
        rows = "".join(" ".join(f"{v!r}" for v in row.item()) + " \n" for row in table).encode()
        first = b"2 0 0 7\n0 8\n0.5\n"
    path.write_bytes(head.replace(b"element vertex", before) + behind + first + rows)
    assert_same(model, read_ply(path))


@pytest.mark.parametrize(("degree", "kept"), [(0, 1), (1, 4), (2, 9), (3, 16), (4, 16), (5, 16)])
def test_degrees_above_3_are_cut(tmp_path: Path, degree: int, kept: int) -> None:
    bands = (degree + 1) ** 2
    sh = np.random.default_rng(0).normal(size=(7, bands, 3)).astype(np.float32)
    write_foreign(tmp_path / "m.ply", columns(arrays() | {"sh": sh}))
    np.testing.assert_array_equal(read_ply(tmp_path / "m.ply")["sh"], sh[:, :kept])


def test_colours_as_bytes(tmp_path: Path) -> None:
    """nerfstudio's `--ply-color-mode rgb`."""
    values = {k: v for k, v in columns(arrays()).items() if not k.startswith("f_")}
    values |= {"red": np.arange(7), "green": np.full(7, 255), "blue": np.full(7, 51)}
    kinds = dict.fromkeys(("red", "green", "blue"), ("uchar", "u1"))
    write_foreign(tmp_path / "m.ply", values, kinds=kinds)
    found = 0.5 + 0.28209479 * read_ply(tmp_path / "m.ply")["sh"][:, 0]
    wanted = np.stack((np.arange(7) / 255, np.ones(7), np.full(7, 0.2)), axis=1)
    np.testing.assert_allclose(found, wanted, atol=1e-6)


@pytest.mark.parametrize(
    ("comment", "axis"),
    [
        ("Vertical Axis: z", (0, 0, 1)),  # nerfstudio
        ("Vertical axis: y", (0, 1, 0)),  # Brush until June 2026
        ("Vertical axis: 0.1 -0.9 0", (0.1, -0.9, 0)),  # Brush since
        ("vertical axis:  -Y ", (0, -1, 0)),
        ("up_axis = z-up", (0, 0, 1)),
        ("Up Axis: [0, 0, 1]", (0, 0, 1)),
        ("Vertical axis: 0 0 0", None),
        ("Vertical axis: nan 0 1", None),
        ("Vertical axis: . . .", None),
        ("Vertical axis: up", None),
        ("The vertical axis: z", None),
    ],
)
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_the_axis_that_points_up(tmp_path: Path, comment: str, axis: object, end: str) -> None:
    lines = ["ply", f"comment {comment}", "element vertex 0", "end_header", ""]
    (tmp_path / "m.ply").write_bytes(end.join(lines).encode())
    assert up_axis(tmp_path / "m.ply") == axis


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"ply",
        b"PK\x03\x04",
        b"ply\nformat binary_little_endian 1.0\nend_header\n",
        b"ply\nformat binary_little_endian 1.0\nelement vertex x\nproperty float x\nend_header\n",
        b"ply\nformat binary_little_endian 1.0\nelement vertex 0\nproperty foo x\nend_header\n",
        b"ply\nformat binary_little_endian 1.0\nelement vertex 0\n"
        b"property float x\nproperty float x\nend_header\n",
        *(
            b"ply\nformat binary_little_endian 1.0\n"
            b"element vertex %s\nproperty float x\nend_header\n" % number
            for number in (b"9" * 5000, b"9" * 18, b"-1", b"1e3", b"\xc2\xb2", b"1_0")
        ),
        b"ply\nformat binary_little_endian 1.0\nelement vertex 0\nproperty float x\n"
        b"element vertex 0\nproperty float y\nend_header\n",
    ],
)
def test_what_is_no_ply_is_refused(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "m.ply").write_bytes(data)
    refused(tmp_path / "m.ply")


def test_a_compressed_file_is_named(tmp_path: Path) -> None:
    head = b"ply\nformat binary_little_endian 1.0\nelement chunk 1\nproperty float min_x\n"
    rows = b"element vertex 1\nproperty uint packed_position\nend_header\n"
    (tmp_path / "m.ply").write_bytes(head + rows + bytes(8))
    assert "compressed" in refused(tmp_path / "m.ply")


@pytest.mark.parametrize("gone", ["x", "f_dc_2", "f_rest_44", "opacity", "scale_1", "rot_3"])
def test_missing_property_is_refused(tmp_path: Path, gone: str) -> None:
    values = columns(arrays())
    del values[gone]
    write_foreign(tmp_path / "m.ply", values)
    refused(tmp_path / "m.ply")


def test_2d_gaussians_are_named(tmp_path: Path) -> None:
    values = columns(arrays())
    del values["scale_2"]
    write_foreign(tmp_path / "m.ply", values)
    assert "2D Gaussians" in refused(tmp_path / "m.ply")


def test_missing_file_is_refused(tmp_path: Path) -> None:
    refused(tmp_path / "none.ply")


def test_model_round_trip(tmp_path: Path) -> None:
    model = Gaussians.from_arrays(arrays())
    model.save_ply(tmp_path / "m.ply")
    back = Gaussians.load_ply(tmp_path / "m.ply")
    for name, tensor in model.tensors().items():
        assert tensor.equal(back.tensors()[name])


def test_antialiasing_is_a_comment_and_changes_nothing_else(tmp_path: Path) -> None:
    plain, smooth = tmp_path / "plain.ply", tmp_path / "smooth.ply"
    write_ply(plain, arrays())
    write_ply(smooth, arrays(), target=VIEWERS)
    assert (target_of(plain).antialiased, target_of(smooth).antialiased) == (False, True)
    assert b"comment" not in plain.read_bytes()
    line = b"comment SplatRenderMode: mip\n"
    assert smooth.read_bytes().replace(line, b"", 1) == plain.read_bytes()
    for name, values in read_ply(smooth).items():
        np.testing.assert_array_equal(values, arrays()[name])


@pytest.mark.parametrize(
    ("comments", "expected"),
    [
        ((), False),
        (("SplatRenderMode: mip",), True),
        (("Exported from Brush", "  SPLATRENDERMODE:   MIP  "), True),
        (("SplatRenderMode: default",), False),
        (("SplatRenderMode: 2dgs",), False),
        (("antialiased 1",), True),
        (("antialiased 0",), False),
        (("antialiased 1", "SplatRenderMode: default"), False),  # the last one counts
        (("SplatRenderMode: default", "antialiased 1"), True),
        (("not SplatRenderMode: mip",), False),
    ],
)
def test_what_others_write_of_antialiasing(
    tmp_path: Path, comments: tuple[str, ...], expected: bool
) -> None:
    path = tmp_path / "a.ply"
    write_ply(path, arrays())
    written = path.read_bytes()
    lines = b"".join(f"comment {comment}\n".encode() for comment in comments)
    path.write_bytes(written.replace(b"element", lines + b"element", 1))
    assert target_of(path).antialiased is expected
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n", 4 + len(comments)))
    assert target_of(path).antialiased is expected
    path.write_bytes(written + lines)  # behind the header, it is data
    assert not target_of(path).antialiased


def filtered(path: Path, model: dict[str, np.ndarray], blur: np.ndarray, *comments: str) -> Path:
    """A file as Mip-Splatting writes it."""
    write_foreign(path, {**columns(model), "filter_3D": blur})
    lines = b"".join(f"comment {comment}\n".encode() for comment in comments)
    path.write_bytes(path.read_bytes().replace(b"element", lines + b"element", 1))
    return path


def test_the_filter_of_mip_splatting_is_applied(tmp_path: Path) -> None:
    """Files store sizes and opacities without it; its renderer has these formulas."""
    model, blur = arrays(), np.geomspace(0.01, 10, 7)
    found = read_ply(filtered(tmp_path / "a.ply", model, blur))
    squares = np.exp(2 * model["log_scales"].astype(float))
    after = squares + blur[:, None] ** 2
    opacity = 1 / (1 + np.exp(-model["logit_opacities"].astype(float)))
    opacity *= np.sqrt(squares.prod(axis=1) / after.prod(axis=1))
    np.testing.assert_allclose(np.exp(found["log_scales"]), np.sqrt(after), rtol=1e-5)
    np.testing.assert_allclose(1 / (1 + np.exp(-found["logit_opacities"])), opacity, rtol=1e-4)
    for name in ("means", "quats", "sh"):
        np.testing.assert_array_equal(found[name], model[name])
    assert {values.dtype for values in found.values()} == {np.dtype(np.float32)}


def test_the_filter_at_its_limits(tmp_path: Path) -> None:
    """No blur changes no bit; a flat Gaussian that is blurred loses all of its opacity."""
    model = arrays()
    model["log_scales"][0, 0] = model["log_scales"][1, 0] = -np.inf
    model["logit_opacities"][2:5] = (np.inf, -np.inf, np.nan)
    found = read_ply(filtered(tmp_path / "a.ply", model, np.array([0, 1, 1, 1, 1, 0, np.nan])))
    for row in (0, 5):
        for name, values in model.items():
            assert found[name][row].tobytes() == values[row].tobytes()
    assert found["log_scales"][1, 0] == 0 and found["logit_opacities"][1] == -np.inf
    assert -30 < found["logit_opacities"][2] < 30 and found["logit_opacities"][3] == -np.inf
    assert np.isnan(found["logit_opacities"][[4, 6]]).all()


@pytest.mark.parametrize(
    ("comments", "expected"),
    [
        ((), True),
        (("SplatRenderMode: default",), False),
        (("antialiased 1",), True),
    ],
)
def test_models_of_mip_splatting_are_antialiased(
    tmp_path: Path, comments: tuple[str, ...], expected: bool
) -> None:
    """They are trained so; their files have no comment, but one would count."""
    path = filtered(tmp_path / "a.ply", arrays(), np.ones(7), *comments)
    assert target_of(path).antialiased is expected
    write_foreign(path, {**columns(arrays()), "filter": np.ones(7)})
    words = b"by another tool", b"property float filter_3D"
    path.write_bytes(path.read_bytes().replace(*words, 1))
    assert not target_of(path).antialiased


def test_long_headers(tmp_path: Path) -> None:
    """Programs write their settings into comments; 70,000 characters were 'not a PLY file'."""
    path, model = tmp_path / "a.ply", arrays()
    write_ply(path, model, target=VIEWERS)
    written = path.read_bytes()
    long = b"comment " + b"z" * 70_000 + b"\n"
    path.write_bytes(written.replace(b"comment", long + b"comment", 1))
    assert_same(model, read_ply(path))
    assert target_of(path).antialiased
    path.write_bytes(written.replace(b"comment", long * 16 + b"comment", 1))
    assert "the header of this PLY is longer than 1 MB" in refused(path)


@pytest.mark.parametrize("target", TARGETS.values(), ids=lambda target: target.name)
def test_a_file_says_what_it_is_made_for(tmp_path: Path, target: Target) -> None:
    path = tmp_path / "a.ply"
    write_ply(path, arrays(), target)
    assert target_of(path) == target
    head = path.read_bytes().partition(b"end_header")[0]
    assert (b"SplatRenderMode: mip" in head) == target.antialiased
    assert (b"made_for" in head) == target.linear_light  # the others are as they always were


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (("made_for eevee", "SplatRenderMode: mip"), EEVEE),
        (("made_for something", "SplatRenderMode: mip"), VIEWERS),
        (("made_for something",), PLAIN),
        (("made_for cycles", "made_for eevee"), EEVEE),  # the last one counts
    ],
)
def test_targets_of_other_files(tmp_path: Path, lines: tuple[str, ...], expected: Target) -> None:
    path = tmp_path / "a.ply"
    write_ply(path, arrays())
    comments = "".join(f"comment {line}\n" for line in lines).encode()
    path.write_bytes(path.read_bytes().replace(b"element vertex", comments + b"element vertex", 1))
    assert target_of(path) == expected


def test_antialiasing_of_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(RunFolderError, match="Cannot read"):
        target_of(tmp_path / "no.ply")


def with_lists(path: Path, rows: bytes, count: int) -> None:
    """Our PLY with an element of lists ahead of the vertices."""
    write_ply(path, arrays(5, 1))
    head, _, rest = path.read_bytes().partition(b"element vertex")
    more = f"element face {count}\nproperty list uchar int i\nproperty short s\n".encode()
    head, vertex, rest = head + more, *rest.split(b"end_header\n", 1)
    path.write_bytes(head + b"element vertex" + vertex + b"end_header\n" + rows + rest)


def test_lists_of_all_lengths_are_skipped(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    rows = b"".join(bytes([k, *range(4 * k), 9, 9]) for k in (3, 0, 4, 60, 3))
    with_lists(path, rows, 5)
    values = arrays(5, 1)
    assert read_ply(path)["means"].tobytes() == values["means"].tobytes()


@pytest.mark.parametrize("count", [10**17, 10**7])
def test_more_lists_than_bytes(count: int, tmp_path: Path) -> None:
    """Each was read in turn, for ever."""
    with_lists(tmp_path / "a.ply", bytes(1 << 20), count)
    with pytest.raises(RunFolderError, match="its element face is cut off"):
        read_ply(tmp_path / "a.ply")


def test_a_line_of_far_too_many_numbers(tmp_path: Path) -> None:
    """Memory was taken for so many in every line; what was said was that it is full."""
    write_ply(tmp_path / "a.ply", arrays(4000, 1))
    head = (tmp_path / "a.ply").read_bytes().partition(b"end_header\n")[0]
    head = head.replace(b"binary_little_endian", b"ascii") + b"end_header\n"
    text = b"1 " * 300_000 + b"\n" + (b"1 " * 17 + b"\n") * 4000
    (tmp_path / "a.ply").write_bytes(head + text)
    with pytest.raises(RunFolderError, match="damaged: its Gaussians have 300000 of 17 numbers"):
        read_ply(tmp_path / "a.ply")


def as_text(path: Path, model: dict[str, np.ndarray]) -> None:
    """The model as an ASCII PLY, with numbers that come back bit for bit."""
    write_ply(path, model)
    head, end, rows = path.read_bytes().partition(b"end_header\n")
    numbers = np.frombuffer(rows, "<f4").reshape(len(model["means"]), -1)
    lines = [" ".join(repr(float(value)) for value in row) for row in numbers]
    head = head.replace(b"binary_little_endian", b"ascii") + end
    path.write_bytes(head + "\n".join(lines).encode() + b"\n")


@pytest.mark.parametrize("kind", ["binary", "ascii", "lists"])
def test_a_stop_while_reading_is_heard(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.setattr(ply_rows, "ROWS", 10)
    monkeypatch.setattr(ply_rows, "LINES", 10)
    path, model, asked = tmp_path / "a.ply", arrays(35, 4), [0]
    if kind == "lists":
        with_lists(path, bytes([0, 9, 9]) * 35, 35)
        model = arrays(5, 1)
    else:
        (write_ply if kind == "binary" else as_text)(path, model)

    def stop_at_third() -> None:
        asked[0] += 1
        if asked[0] == 3:
            raise Stopped

    with pytest.raises(Stopped):
        read_ply(path, stop_at_third)
    assert_same(model, read_ply(path))  # whatever the number of parts


@pytest.mark.parametrize("kind", ["blank lines", "a row of lists"])
def test_a_stop_is_heard_where_nothing_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.setattr(ply_rows, "LINES", 10)
    path, asked = tmp_path / "a.ply", []
    if kind == "blank lines":
        as_text(path, arrays(3, 1))
        path.write_bytes(path.read_bytes().replace(b"end_header\n", b"end_header\n" + b"\n" * 500))
    else:
        write_ply(path, arrays(3, 1))
        lists = b"".join(b"property list uchar uchar a%d\n" % k for k in range(500))
        head = b"element wide 1\n" + lists + b"element vertex"
        data = path.read_bytes().replace(b"element vertex", head)
        path.write_bytes(data.replace(b"end_header\n", b"end_header\n" + bytes(500)))
    read_ply(path, lambda: asked.append(1))
    assert len(asked) > 50


def test_a_file_that_is_cut_off_while_it_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ply_rows, "ROWS", 10)
    path = tmp_path / "a.ply"
    write_ply(path, arrays(4000, 1))

    def cut_off() -> None:
        os.truncate(path, path.stat().st_size // 2)

    with pytest.raises(RunFolderError, match=r"it has [0-9]+ of 4000 Gaussians"):
        read_ply(path, cut_off)


def test_an_ascii_file_without_its_rows(tmp_path: Path) -> None:
    as_text(tmp_path / "a.ply", arrays(3, 1))
    head, end, rows = (tmp_path / "a.ply").read_bytes().partition(b"end_header\n")
    (tmp_path / "a.ply").write_bytes(head + end + b"\n" * len(rows))
    with pytest.raises(RunFolderError, match="truncated: it has 0 of 3"):
        read_ply(tmp_path / "a.ply")


@pytest.mark.parametrize("element", ["", "element x 1\nproperty float a\n"])
def test_an_ascii_file_without_line_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, element: str
) -> None:
    """A line is not read whole: a file may be one of gigabytes."""
    monkeypatch.setattr(ply_rows, "MAX_HEADER", 10_000)
    path = tmp_path / "a.ply"
    write_ply(path, arrays(1))
    head = path.read_bytes().partition(b"end_header\n")[0].decode()
    head = head.replace("binary_little_endian", "ascii").replace("element", f"{element}element", 1)
    path.write_text(head + "end_header\n" + "1 " * 10**6)
    with pytest.raises(RunFolderError, match="a line is longer"):
        read_ply(path)
