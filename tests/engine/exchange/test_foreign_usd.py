"""OpenUSD of other programs: floats and halves, units, axes, colour spaces.

What is read is compared with the values that the files were built of.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from roigs_engine.errors import RunFolderError
from roigs_engine.exchange import formats
from roigs_engine.exchange.transform import encoded
from tests.engine.exchange.foreign_checks import STEPS, assert_holds, converted
from tests.engine.exchange.foreign_files import SH_C0, alphas, values

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
