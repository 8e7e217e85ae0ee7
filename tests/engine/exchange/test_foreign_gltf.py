"""glTF of other programs: drafts, text, several meshes, SPZ inside, linear light.

What is read is compared with the values that the files were built of.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from roigs_engine.errors import EngineError
from roigs_engine.exchange import formats
from roigs_engine.exchange.transform import encoded
from tests.engine.exchange.foreign_checks import STEPS, assert_holds
from tests.engine.exchange.foreign_files import (
    COUNT,
    NAME,
    SH_C0,
    Gltf,
    alphas,
    own,
    saved,
    spz,
    values,
)


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
