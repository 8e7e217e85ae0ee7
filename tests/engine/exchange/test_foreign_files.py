"""What valid files of other programs say is what is read: against the values they were built of."""

from __future__ import annotations

import gzip
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from roigs_engine.cli import main
from roigs_engine.errors import ConfigError, EngineError, RunFolderError
from roigs_engine.exchange import formats
from roigs_engine.exchange.arrays import UP
from roigs_engine.exchange.transform import encoded
from roigs_engine.formats.splat_ply import read_ply, write_ply
from roigs_engine.formats.targets import VIEWERS
from tests.engine.exchange.foreign_files import (
    COUNT,
    NAME,
    SH_C0,
    Gltf,
    alphas,
    own,
    record,
    saved,
    spz,
    values,
)

SYSTEMS = (
    *("LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF"),
    *("LFD", "RFD", "LFU", "RFU", "LBD", "RBD", "LBU", "RBU"),
)
STEPS = {"means": 1e-3, "log_scales": 1e-4, "logit_opacities": 0.1, "sh": 0.02, "quats": 0.01}
EXACT = dict.fromkeys(STEPS, 1e-4)


def assert_holds(
    path: Path, model: dict[str, np.ndarray], steps: dict[str, float] | None = None
) -> None:
    """The file has these Gaussians, with rotations of either sign."""
    found = formats.read(path)
    for name, near in (steps or EXACT).items():
        rows = found[name]
        if name == "quats":
            rows = rows * np.sign((rows * model[name]).sum(axis=1, keepdims=True))
        wanted = model[name][:, :16] if name == "sh" else model[name]
        np.testing.assert_allclose(rows, wanted, atol=near, err_msg=name)


def converted(tmp_path: Path, source: Path, *options: str, to: str = "out.ply") -> dict[str, Any]:
    assert main(["convert", str(source), str(tmp_path / to), *options]) == 0
    return read_ply(tmp_path / to)


def with_zstd(version: int) -> None:
    if version == 4:
        pytest.importorskip("zstandard")


# --- SPZ ---


@pytest.mark.parametrize("degree", range(5))
@pytest.mark.parametrize("version", [1, 2, 3, 4])
def test_spz_of_all_versions_and_degrees(version: int, degree: int, tmp_path: Path) -> None:
    with_zstd(version)
    model = values(degree)
    assert_holds(saved(tmp_path / "a.spz", spz(model, version)), model, STEPS)


ORBIT = record(0xADBE0002, struct.pack("<3f", -0.5, 1.2, 0.3))
PLACE = record(0x4E530001, bytes(90))


@pytest.mark.parametrize("version", [2, 3, 4])
@pytest.mark.parametrize("cut", [b"", b"\x01\x02", record(9, b"")[:6], struct.pack("<II", 9, 99)])
def test_spz_with_unknown_extensions(version: int, cut: bytes, tmp_path: Path) -> None:
    """Also one that is cut off at the end, which the format's own reader ignores."""
    with_zstd(version)
    model = values(1)
    data = spz(model, version, ORBIT + PLACE + record(0xDEAD0001, b"") + cut)
    assert_holds(saved(tmp_path / "a.spz", data), model, STEPS)
    assert (formats.frame(tmp_path / "a.spz") == np.eye(4)).all()


@pytest.mark.parametrize("number", range(1, 17))
@pytest.mark.parametrize("version", [3, 4])
def test_spz_says_its_coordinate_system(version: int, number: int, tmp_path: Path) -> None:
    """A point that is 1 right, 2 up and 3 in front is there in a PLY, of which y points down."""
    with_zstd(version)
    model = values(1)
    place = {"R": 1.0, "L": -1.0, "U": 2.0, "D": -2.0, "F": 3.0, "B": -3.0}
    model["means"][:] = [place[letter] for letter in SYSTEMS[number - 1]]
    said = ORBIT + record(0xADBE0003, struct.pack("<I", number))
    source = saved(tmp_path / "a.spz", spz(model, version, said))
    found = converted(tmp_path, source)
    np.testing.assert_allclose(found["means"], np.tile([1, -2, 3], (COUNT, 1)), atol=1e-3)


def test_spz_from_a_left_handed_system_is_mirrored_as_a_whole(tmp_path: Path) -> None:
    """Rotations and colours go with the positions: as from the mirrored model, right-handed."""
    model = values(3)
    mirrored = {name: rows.copy() for name, rows in model.items()}
    mirrored["means"][:, 0] *= -1
    mirrored["quats"][:, 2:] *= -1  # about y and z
    odd_in_x = [3, 4, 7, 10, 13, 15]
    mirrored["sh"][:, odd_in_x] *= -1
    said = record(0xADBE0003, struct.pack("<I", SYSTEMS.index("LUB") + 1))
    left = converted(tmp_path, saved(tmp_path / "a.spz", spz(model, 3, said)))
    right = converted(tmp_path, saved(tmp_path / "b.spz", spz(mirrored, 3)))
    for name in ("means", "sh"):
        np.testing.assert_allclose(left[name], right[name], atol=0.02, err_msg=name)
    covariances = [_covariances(found) for found in (left, right)]
    np.testing.assert_allclose(*covariances, atol=0.02)


def _covariances(model: dict[str, np.ndarray]) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    axes = Rotation.from_quat(np.roll(model["quats"], -1, axis=1)).as_matrix()
    axes = axes * np.exp(model["log_scales"])[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


def test_the_option_wins_over_what_the_file_says(tmp_path: Path) -> None:
    said = record(0xADBE0003, struct.pack("<I", SYSTEMS.index("RDF") + 1))
    model = values()
    source = saved(tmp_path / "a.spz", spz(model, 3, said))
    raw = converted(tmp_path, source, "--from-up=y", "--up=y")
    np.testing.assert_allclose(raw["means"], model["means"], atol=1e-3)
    with pytest.raises(RunFolderError, match="coordinate system 17 of SPZ is not supported"):
        formats.frame(saved(source, spz(model, 3, record(0xADBE0003, struct.pack("<I", 17)))))
    unsaid = record(0xADBE0003, struct.pack("<I", 0))
    assert (formats.frame(saved(source, spz(model, 3, unsaid))) == np.eye(4)).all()


@pytest.mark.parametrize("version", [3, 4])
def test_spz_without_gaussians_is_whole(version: int, tmp_path: Path) -> None:
    with_zstd(version)
    none = {name: rows[:0] for name, rows in values(1).items()}
    with pytest.raises(RunFolderError, match="has no Gaussians that can be drawn"):
        formats.read(saved(tmp_path / "a.spz", spz(none, version)))


def test_spz_of_the_future_is_not_called_damaged(tmp_path: Path) -> None:
    whole = bytearray(gzip.decompress(spz(values(), 3)))
    struct.pack_into("<I", whole, 4, 5)
    source = saved(tmp_path / "a.spz", gzip.compress(bytes(whole)))
    with pytest.raises(RunFolderError, match="version 5 of SPZ is not supported"):
        formats.read(source)


# --- PLY ---


@pytest.mark.parametrize(
    ("comment", "up"), [("Vertical Axis: z", "z"), ("Vertical axis: y", "y"), ("other", "-y")]
)
@pytest.mark.parametrize("suffix", [".ply", ".compressed.ply"])
def test_ply_says_its_axis(
    comment: str, up: str, suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if suffix != ".ply":
        pytest.importorskip("gsply")
    source = tmp_path / f"a{suffix}"
    model = {name: rows.astype(np.float32) for name, rows in values().items()}
    formats.write(source, model)
    source.write_bytes(
        source.read_bytes().replace(b"\nelement", f"\ncomment {comment}\nelement".encode(), 1)
    )
    model = formats.read(source)
    found = converted(tmp_path, source, "--up=z")
    assert ("says how its axes point" in "".join(capsys.readouterr())) is (up != "-y")
    np.testing.assert_allclose(found["means"], model["means"] @ np.array(UP[up]), atol=1e-5)
    same = converted(tmp_path, source, "--from-up=z", "--up=z")
    np.testing.assert_allclose(same["means"], model["means"], atol=1e-5)


def test_ply_says_any_direction(tmp_path: Path) -> None:
    """Brush writes that of its training."""
    up = np.array([0.2, -0.9, 0.3])
    model = {name: rows.astype(np.float32) for name, rows in values(1).items()}
    model["means"] = np.outer(np.arange(COUNT), up).astype(np.float32)
    write_ply(tmp_path / "a.ply", model)
    text = b"\ncomment Vertical axis: 0.2 -0.9 0.3\nelement"
    saved(tmp_path / "a.ply", (tmp_path / "a.ply").read_bytes().replace(b"\nelement", text, 1))
    found = converted(tmp_path, tmp_path / "a.ply", "--up=z")["means"]
    wanted = np.outer(np.arange(COUNT) * np.linalg.norm(up), (0, 0, 1))
    np.testing.assert_allclose(found, wanted, atol=1e-5)


@pytest.mark.parametrize("degree", [0, 1])
@pytest.mark.parametrize("end", [b"\n", b"\r\n"])
def test_compressed_ply_without_bounds_of_colours(end: bytes, degree: int, tmp_path: Path) -> None:
    """As SuperSplat wrote them in its first year: colours are from 0 to 1."""
    pytest.importorskip("gsply")
    model = {name: rows.astype(np.float32) for name, rows in values(degree).items()}
    model["sh"][0, 0], model["sh"][1, 0] = -0.5 / SH_C0, 0.5 / SH_C0  # so the bounds are 0 and 1
    formats.write(tmp_path / "a.compressed.ply", model)
    wanted = formats.read(tmp_path / "a.compressed.ply")
    head, rows = (tmp_path / "a.compressed.ply").read_bytes().split(b"end_header\n", 1)
    for name in ("min_r", "min_g", "min_b", "max_r", "max_g", "max_b"):
        head = head.replace(f"property float {name}\n".encode(), b"")
    data = (head + b"end_header\n").replace(b"\n", end) + rows[:48] + rows[72:]
    found = formats.read(saved(tmp_path / "b.compressed.ply", data))
    for name in STEPS:
        np.testing.assert_allclose(found[name], wanted[name], atol=1e-6, err_msg=name)


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        (b"little", b"big", "in the format 'binary_big_endian' is not supported"),
        (b"end_header", b"element camera 0\nend_header", "element 'camera' .* is not supported"),
        (b"property float max_b\n", b"", "other properties than PlayCanvas's is not supported"),
    ],
)
def test_compressed_ply_of_other_kinds_is_named(
    old: bytes, new: bytes, why: str, tmp_path: Path
) -> None:
    """The first was read as noise."""
    pytest.importorskip("gsply")
    model = {name: rows.astype(np.float32) for name, rows in values().items()}
    formats.write(tmp_path / "a.compressed.ply", model)
    data = (tmp_path / "a.compressed.ply").read_bytes().replace(old, new, 1)
    with pytest.raises(RunFolderError, match=why):
        formats.read(saved(tmp_path / "a.compressed.ply", data))


# --- glTF ---


def test_gltf_with_logarithms_of_sizes(tmp_path: Path) -> None:
    """As splat-transform wrote them from March to June 2026."""
    file, model = Gltf(), values(2)
    at = file.gaussians(model)
    at[f"{NAME}:SCALE"] = file.accessor(model["log_scales"].astype("<f4"))
    file.add(at, own())
    assert_holds(saved(tmp_path / "a.glb", file.glb()), model)


@pytest.mark.parametrize("sh", [False, True])
@pytest.mark.parametrize("kind", ["<f4", "u1"])
def test_gltf_of_the_first_drafts(kind: str, sh: bool, tmp_path: Path) -> None:
    """Colours and opacities in COLOR_0, names without a prefix."""
    file, model = Gltf(), values(1 if sh else 0)
    at = file.gaussians(model)
    colours = np.column_stack((0.5 + SH_C0 * model["sh"][:, 0], alphas(model)))
    colours = np.round(colours * 255).astype("u1") if kind == "u1" else colours.astype(kind)
    at["_SCALE"], at["_ROTATION"] = at.pop(f"{NAME}:SCALE"), at.pop(f"{NAME}:ROTATION")
    del at[f"{NAME}:OPACITY"], at[f"{NAME}:SH_DEGREE_0_COEF_0"]
    file.add(at | {"COLOR_0": file.accessor(colours)}, {NAME: {}})
    assert_holds(saved(tmp_path / "a.glb", file.glb()), model, STEPS)


def test_gltf_of_several_primitives_meshes_and_nodes_is_one_model(tmp_path: Path) -> None:
    file, first, second = Gltf(), values(1), values(3)
    primitive = file.add(file.gaussians(first), own(), translation=[10, 0, 0])
    file.record["meshes"][0]["primitives"].append({**primitive, "extensions": {}})  # points
    file.record["meshes"][0]["primitives"].append(primitive)
    turn = [0, np.sqrt(0.5), 0, np.sqrt(0.5)]  # a quarter about y: z becomes x
    file.add(file.gaussians(second), own(), scale=[2, 2, 2])
    file.record["nodes"] += [{"children": [1], "rotation": turn}, {"mesh": 0}]
    file.record["scenes"][0]["nodes"] = [0, 2]  # the last node is not shown
    found = formats.read(saved(tmp_path / "a.glb", file.glb()))
    moved = second["means"][:, (2, 1, 0)] * (2, 2, -2)
    wanted = [first["means"] + (10, 0, 0)] * 2 + [moved]
    np.testing.assert_allclose(found["means"], np.concatenate(wanted), atol=1e-5)
    assert found["sh"].shape == (3 * COUNT, 16, 3)
    np.testing.assert_allclose(found["sh"][:COUNT, :4], first["sh"], atol=1e-5)
    assert not found["sh"][:COUNT, 4:].any()
    sizes = np.sort(found["log_scales"][2 * COUNT :], axis=1)
    wanted_sizes = np.sort(second["log_scales"] + np.log(2), axis=1)
    np.testing.assert_allclose(sizes, wanted_sizes, atol=1e-4)


def test_gltf_with_sparse_and_missing_values(tmp_path: Path) -> None:
    file, model = Gltf(), values(1)
    at = file.gaussians(model)
    rows = np.array([1, 3], "<u2")
    place, replaced = np.array([[1, 2, 3], [4, 5, 6]], "<f4"), model["means"].copy()
    replaced[rows] = place
    sparse = {
        "count": 2,
        "indices": {"bufferView": file.view(rows.tobytes()), "componentType": 5123},
        "values": {"bufferView": file.view(place.tobytes())},
    }
    file.record["accessors"][at["POSITION"]]["sparse"] = sparse
    zeros = file.record["accessors"][at[f"{NAME}:SH_DEGREE_1_COEF_0"]]
    del zeros["bufferView"]
    file.add(at, own())
    model["sh"][:, 1] = 0
    source = saved(tmp_path / "a.glb", file.glb())
    assert_holds(source, model | {"means": replaced})


@pytest.mark.parametrize("uri", [None, "parts/my%20numbers.bin"])
def test_gltf_as_text(uri: str | None, tmp_path: Path) -> None:
    file, model = Gltf(), values(1)
    file.add(file.gaussians(model), own())
    (tmp_path / "parts").mkdir()
    saved(tmp_path / "parts" / "my numbers.bin", file.blob)
    assert_holds(saved(tmp_path / "a.gltf", file.gltf(uri)), model)


@pytest.mark.parametrize(
    ("uri", "why"),
    [
        ("gone.bin", "needs gone.bin, which cannot be read"),
        ("../a.bin", "is not below its folder"),
        ("/etc/passwd", "is not below its folder"),
        ("%2e%2e/a.bin", "is not below its folder"),
        ("http://a.com/a.bin", "cannot be read"),
        ("data:;base64,!!", "not a whole glTF"),
    ],
)
def test_gltf_with_bytes_elsewhere(uri: str, why: str, tmp_path: Path) -> None:
    file = Gltf()
    file.add(file.gaussians(values()), own())
    saved(tmp_path / "a.bin", file.blob)
    (tmp_path / "in").mkdir()
    with pytest.raises(EngineError, match=why):
        formats.read(saved(tmp_path / "in" / "a.gltf", file.gltf(uri)))


@pytest.mark.parametrize("name", [f"{NAME}_compression_spz", f"{NAME}_compression_spz_2"])
@pytest.mark.parametrize("version", [2, 3])
def test_gltf_with_spz_inside(name: str, version: int, tmp_path: Path) -> None:
    """Its axes are left, up and front; they were packed from there to SPZ's."""
    file, model = Gltf(), values(0)
    view = file.view(spz(model, version))
    file.add({}, own(extensions={name: {"bufferView": view}}))
    found = formats.read(saved(tmp_path / "a.glb", file.glb()))
    np.testing.assert_allclose(found["means"], model["means"] * (-1, 1, -1), atol=1e-3)


def test_gltf_of_cesium_with_spz_inside(tmp_path: Path) -> None:
    """The first draft, whose files CesiumJS reads without turning anything."""
    file, model = Gltf(), values(1)
    view = file.view(spz(model, 2))
    file.add({}, {"KHR_spz_gaussian_splats_compression": {"bufferView": view}})
    assert_holds(saved(tmp_path / "a.glb", file.glb()), model, STEPS)


# --- colours ---


def test_gltf_of_linear_light(tmp_path: Path) -> None:
    file, model = Gltf(), values(0)
    file.add(file.gaussians(model), own(colorSpace="lin_rec709_display"))
    found = formats.read(saved(tmp_path / "a.glb", file.glb()))["sh"]
    wanted = encoded(0.5 + SH_C0 * model["sh"])
    np.testing.assert_allclose(0.5 + SH_C0 * found, wanted, atol=1e-5)


def test_the_curve_of_srgb() -> None:
    light = np.array([-0.1, 0, 0.002, 0.0031308, 0.214041, 0.5, 1])
    wanted = [0, 0, 0.02584, 0.04045, 0.5, 0.735357, 1]
    np.testing.assert_allclose(encoded(light), wanted, atol=1e-5)


def test_linear_light_that_depends_on_the_view(tmp_path: Path) -> None:
    """From every side the colour is the encoded one, as well as SH of this degree can be."""
    from roigs_engine.exchange.transform import recoloured, sphere
    from roigs_engine.rasterize.reference import sh_basis

    torch = pytest.importorskip("torch")
    dice = np.random.default_rng(0)
    sh = dice.normal(size=(40, 16, 3)).astype(np.float32) * 0.05
    after = recoloured(sh)
    basis = sh_basis(torch.from_numpy(sphere(500))).numpy()
    before, seen = (0.5 + np.einsum("dk,nkc->ndc", basis, values) for values in (sh, after))
    assert np.abs(seen - encoded(before)).max() < 0.03 < np.abs(seen - before).max()
    np.testing.assert_allclose(after[:, 0], recoloured(sh[:, :1])[:, 0], atol=1e-6)


# --- OpenUSD ---

SH = "radiance:sphericalHarmonicsCoefficients"


def stage_of(path: Path, model: dict[str, np.ndarray], *, half: bool = False, **layer: Any) -> Any:
    """A stage with one prim, /World/G."""
    from pxr import Sdf, Usd, UsdVol, Vt

    stage = Usd.Stage.CreateNew(str(path))
    for key, value in layer.items():
        stage.SetMetadata(key, value)
    stage.DefinePrim("/World", "Xform")
    prim = UsdVol.ParticleField3DGaussianSplat.Define(stage, Sdf.Path("/World/G")).GetPrim()
    rows = {
        "positions": (Vt.Vec3fArray, Vt.Vec3hArray, model["means"]),
        "scales": (Vt.Vec3fArray, Vt.Vec3hArray, np.exp(model["log_scales"])),
        "orientations": (Vt.QuatfArray, Vt.QuathArray, np.roll(model["quats"], -1, axis=1)),
        "opacities": (Vt.FloatArray, Vt.HalfArray, alphas(model)),
        SH: (Vt.Vec3fArray, Vt.Vec3hArray, model["sh"].reshape(-1, 3)),
    }
    for name, (whole, short, numbers) in rows.items():
        attribute = prim.GetAttribute(f"{name}h" if half else name)
        kind = short if half else whole
        attribute.Set(kind.FromNumpy(np.ascontiguousarray(numbers, "f2" if half else "f4")))
    degree = int(np.sqrt(model["sh"].shape[1])) - 1
    prim.GetAttribute("radiance:sphericalHarmonicsDegree").Set(degree)
    return stage


@pytest.mark.parametrize("half", [False, True])
@pytest.mark.parametrize("degree", [0, 3, 4])
@pytest.mark.parametrize("suffix", [".usda", ".usd"])
def test_openusd_of_floats_and_halves(suffix: str, degree: int, half: bool, tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    model = values(degree)
    stage_of(tmp_path / f"a{suffix}", model, half=half).Save()
    steps = dict.fromkeys(STEPS, 5e-3 if half else 1e-4)
    assert_holds(tmp_path / f"a{suffix}", model, steps)


def test_openusd_in_centimetres_and_z_up(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    model = values(0)
    stage_of(tmp_path / "a.usda", model, upAxis="Z", metersPerUnit=0.01).Save()
    found = formats.read(tmp_path / "a.usda")
    metres = 0.01 * model["means"]
    np.testing.assert_allclose(found["means"], metres, atol=1e-6)
    upright = metres[:, (0, 2, 1)] * (1, 1, -1)
    for wanted, options in (
        (upright, ("--up=y",)),
        (upright, ("--from-up=z", "--up=y")),
        (metres, ("--from-up=y", "--up=y")),  # the option wins
    ):
        raw = converted(tmp_path, tmp_path / "a.usda", *options)
        np.testing.assert_allclose(raw["means"], wanted, atol=1e-6)
    sizes = np.sort(found["log_scales"], axis=1)
    np.testing.assert_allclose(
        sizes, np.sort(model["log_scales"], axis=1) + np.log(0.01), atol=1e-4
    )


@pytest.mark.parametrize(
    ("space", "colour"),
    [
        ("lin_rec709_scene", encoded),
        ("lin_rec709_display", encoded),
        ("srgb_rec709_scene", lambda c: c),
        ("srgb_rec709_display", lambda c: c),
        # ACEScg to BT.709, of the ACES documents
        (
            "lin_ap1_scene",
            lambda c: encoded(
                c
                @ np.array(
                    [
                        [1.70505, -0.62179, -0.08326],
                        [-0.13026, 1.14080, -0.01055],
                        [-0.02400, -0.12897, 1.15297],
                    ]
                ).T
            ),
        ),
    ],
)
@pytest.mark.parametrize("where", ["/World", "/World/G", f"/World/G.{SH}"])
def test_openusd_says_its_colour_space(space: str, colour: Any, where: str, tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    from pxr import Usd

    model = values(0)
    stage = stage_of(tmp_path / "a.usda", model)
    if where.endswith(SH):
        stage.GetAttributeAtPath(where).SetColorSpace(space)
    else:
        api = Usd.ColorSpaceAPI.Apply(stage.GetPrimAtPath(where))
        api.CreateColorSpaceNameAttr(space)
    stage.Save()
    found = 0.5 + SH_C0 * formats.read(tmp_path / "a.usda")["sh"]
    np.testing.assert_allclose(found, colour(0.5 + SH_C0 * model["sh"]), atol=2e-3)


def test_openusd_of_several_prims_is_one_model(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    from pxr import Gf, Sdf, UsdGeom

    model = values(1)
    stage = stage_of(tmp_path / "a.usda", model)
    Sdf.CopySpec(stage.GetRootLayer(), "/World/G", stage.GetRootLayer(), "/World/H")
    UsdGeom.Xformable(stage.GetPrimAtPath("/World/H")).AddTranslateOp().Set(Gf.Vec3d(5, 0, 0))
    stage.Save()
    found = formats.read(tmp_path / "a.usda")["means"]
    wanted = np.concatenate((model["means"], model["means"] + (5, 0, 0)))
    np.testing.assert_allclose(found, wanted, atol=1e-5)


def test_openusd_of_other_kinds_is_named(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    (tmp_path / "a.usda").write_text('#usda 1.0\ndef Points "P" {\n}\n')
    with pytest.raises(RunFolderError, match=r"OpenUSD without Particle.* is not supported"):
        formats.read(tmp_path / "a.usda")
    stage = stage_of(tmp_path / "b.usda", values())
    stage.GetPrimAtPath("/World/G").RemoveProperty(SH)
    stage.Save()
    with pytest.raises(RunFolderError, match=f"without {SH} is not supported"):
        formats.read(tmp_path / "b.usda")


# --- SOG, and other names ---


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


def test_zeros_after_an_spz_are_padding(tmp_path: Path) -> None:
    model = values(0)
    whole = spz(model, 3)
    found = formats.read(saved(tmp_path / "a.spz", whole + bytes(64)))
    assert len(found["means"]) == len(model["means"])


@pytest.mark.parametrize("name", ["a.gltf", "meta.json", "a.usd"])
def test_what_is_only_read_is_not_written(name: str, tmp_path: Path) -> None:
    model = {key: rows.astype(np.float32) for key, rows in values().items()}
    with pytest.raises(ConfigError, match="is only read"):
        formats.write(tmp_path / name, model)
