"""glTF and OpenUSD as programs read them that are not ours; compared with the model's own numbers.

glTF by three.js and PlayCanvas, where NODE_PATH has npm's `three` (0.186 or later) or `playcanvas`;
OpenUSD by its validators, and its text by eye.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from roigs_engine.exchange import formats
from tests.engine.exchange.format_cases import arrays, read_by

SH_C0 = 0.28209479177387814

THREE = """\
const [folder, file] = process.argv.slice(1);
const loaders = folder + '/three/examples/jsm/loaders/';
const { GLTFLoader } = await import(loaders + 'GLTFLoader.js');
const { GLTFGaussianSplatLoaderExtension } =
  await import(loaders + 'GLTFGaussianSplatLoaderExtension.js');
globalThis.self = globalThis;
const loader = new GLTFLoader();
loader.register((parser) => new GLTFGaussianSplatLoaderExtension(parser));
const raw = (await import('node:fs')).readFileSync(file);
const whole = raw.buffer.slice(raw.byteOffset, raw.byteOffset + raw.byteLength);
const found = {};
(await loader.parseAsync(whole, '')).scene.traverse((object) => {
  for (const [name, values] of Object.entries(object.splatGeometry?.attributes ?? {}))
    found[name] = Array.from(values.array);
});
console.log(JSON.stringify(found));
"""

PLAYCANVAS = """\
const [folder, file] = process.argv.slice(1);
const source = folder + '/playcanvas/build/playcanvas/src/';
const { NullGraphicsDevice } = await import(source + 'index.js');
const parsers = source + 'framework/parsers/';
const { GlbParser } = await import(parsers + 'glb-parser.js');
const { khrGaussianSplatting } =
  await import(parsers + 'glb/extensions/khr-gaussian-splatting.js');
const device = new NullGraphicsDevice({ addEventListener() {}, width: 1, height: 1 });
const raw = (await import('node:fs')).readFileSync(file);
const whole = raw.buffer.slice(raw.byteOffset, raw.byteOffset + raw.byteLength);
GlbParser.parse('a.glb', '', whole, device, { loader: {} }, {}, [khrGaussianSplatting],
  (error, read) => {
    if (error) throw error;
    const { properties } = read.gsplats[0][0].gsplatData.elements[0];
    const found = properties.map((property) => [property.name, Array.from(property.storage)]);
    process.stdout.write(JSON.stringify(Object.fromEntries(found)), () => process.exit(0));
  });
"""


def covariances(quats: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """(N, 3, 3) from rotations wxyz and sizes."""
    turned = Rotation.from_quat(np.roll(quats, -1, axis=1)).as_matrix() * scales[:, None, :]
    return np.einsum("nij,nkj->nik", turned, turned)


def alphas(values: dict[str, np.ndarray]) -> np.ndarray:
    return 1 / (1 + np.exp(-values["logit_opacities"].astype(np.float64)))


@pytest.fixture
def glb(tmp_path: Path) -> Path:
    """A GLB that we wrote."""
    pytest.importorskip("pygltflib")
    formats.write(tmp_path / "a.glb", arrays())
    return tmp_path / "a.glb"


def test_three_js_reads_our_gltf(glb: Path) -> None:
    needed = "examples/jsm/loaders/GLTFGaussianSplatLoaderExtension.js"
    found, wanted = read_by("three", needed, THREE, glb), arrays()
    np.testing.assert_array_equal(found["position"].reshape(-1, 3), wanted["means"])
    sigma = covariances(wanted["quats"], np.exp(wanted["log_scales"].astype(np.float64)))
    upper = sigma[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    np.testing.assert_allclose(found["covariance"].reshape(-1, 6), upper, atol=1e-6)
    colours = np.column_stack((0.5 + SH_C0 * wanted["sh"][:, 0], alphas(wanted)))
    shown = found["color"].reshape(-1, 4)
    np.testing.assert_allclose(shown, np.clip(colours, 0, 1) * 255, atol=0.51)
    for degree, words in ((1, 3), (2, 4), (3, 6)):
        packed = found[f"sphericalHarmonics{degree}"].astype(np.uint32).view(np.uint8)
        numbers = packed.reshape(-1, 4 * words)[:, : 3 * (2 * degree + 1)]
        rows = wanted["sh"][:, degree**2 : (degree + 1) ** 2].reshape(400, -1)
        np.testing.assert_allclose(numbers, np.clip(rows * 128 + 128, 0, 255), atol=0.51)


def test_playcanvas_reads_our_gltf(glb: Path) -> None:
    needed = "build/playcanvas/src/framework/parsers/glb/extensions/khr-gaussian-splatting.js"
    found, wanted = read_by("playcanvas", needed, PLAYCANVAS, glb), arrays()

    def columns(*names: str) -> np.ndarray:
        return np.stack([found[name] for name in names], axis=1)

    means = columns("x", "y", "z")
    far, order = cKDTree(wanted["means"]).query(means)  # it puts them into an order of its own
    assert not far.any() and len(set(order)) == 400
    wanted = {name: values[order] for name, values in wanted.items()}
    scales = columns("scale_0", "scale_1", "scale_2")
    np.testing.assert_allclose(np.log(scales), wanted["log_scales"], atol=1e-5)
    quats = columns("rot_0", "rot_1", "rot_2", "rot_3")
    same = covariances(wanted["quats"], np.exp(wanted["log_scales"].astype(np.float64)))
    np.testing.assert_allclose(covariances(quats, scales), same, atol=1e-6)
    np.testing.assert_allclose(found["opacity"], alphas(wanted), atol=1e-6)
    for colour in range(3):
        names = [f"f_dc_{colour}", *(f"f_rest_{15 * colour + k}" for k in range(15))]
        np.testing.assert_array_equal(columns(*names), wanted["sh"][:, :, colour])


def numbers(text: str, name: str, width: int) -> np.ndarray:
    """The array of an attribute in OpenUSD's text."""
    found = re.search(rf"[ :]{re.escape(name)} = \[(.*?)\]\n", text, re.DOTALL)
    assert found is not None
    return np.array([float(word) for word in re.findall(r"[-\d.][-\d.e]*", found[1])]).reshape(
        -1, width
    )


def test_the_text_of_openusd_has_the_models_numbers(tmp_path: Path) -> None:
    """By the words of the schema: sizes and opacities are linear, rotations have w first."""
    pytest.importorskip("pxr")
    wanted = arrays()
    formats.write(tmp_path / "a.usda", wanted)
    text = (tmp_path / "a.usda").read_text(encoding="utf-8")
    assert 'def ParticleField3DGaussianSplat "Gaussians"' in text and 'upAxis = "Y"' in text
    np.testing.assert_allclose(numbers(text, "positions", 3), wanted["means"], rtol=1e-6)
    scales = numbers(text, "scales", 3)
    np.testing.assert_allclose(np.log(scales), wanted["log_scales"], atol=1e-5)
    sigma = covariances(wanted["quats"], np.exp(wanted["log_scales"].astype(np.float64)))
    found = covariances(numbers(text, "orientations", 4), scales)
    np.testing.assert_allclose(found, sigma, atol=1e-6)
    np.testing.assert_allclose(numbers(text, "opacities", 1)[:, 0], alphas(wanted), atol=1e-6)
    sh = numbers(text, "radiance:sphericalHarmonicsCoefficients", 3).reshape(400, 16, 3)
    np.testing.assert_allclose(sh, wanted["sh"], rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usdz"])
def test_validators_of_openusd_find_nothing(suffix: str, tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    from pxr import Usd

    validation: Any = pytest.importorskip("pxr.UsdValidation")
    path = tmp_path / f"a{suffix}"
    formats.write(path, arrays())
    context = validation.ValidationContext(validation.ValidationRegistry().GetOrLoadAllValidators())
    found = context.Validate(Usd.Stage.Open(str(path)))
    assert not [error.GetMessage() for error in found]
