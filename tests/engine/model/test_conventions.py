"""docs/conventions.md, line by line, where no other test pins it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from roigs_engine.colmap.project import load_colmap
from roigs_engine.formats.files import atomic_write
from roigs_engine.formats.splat_ply import read_ply, write_ply
from roigs_engine.model.gaussians import SH_C0, Gaussians
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import Camera
from roigs_engine.rasterize import RenderOutput, rasterize
from tests.engine.synthetic_colmap import write_project

CAMERA = Camera(width=48, height=32, fx=40.0, fy=30.0, cx=20.3, cy=18.9)
BACKENDS = pytest.mark.parametrize("backend", ["reference", "cpu"])


def draw(
    backend: str,
    mean: tuple[float, float, float],
    *,
    scale: tuple[float, float, float] = (0.05, 0.05, 0.05),
    quat: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0),
    colour: float = 1.0,
    raw: bool = True,
) -> RenderOutput:
    """One Gaussian before a camera at the origin."""
    sh = torch.full((1, 1, 3), (colour - 0.5) / SH_C0)
    scales, opacity = torch.tensor([scale]), torch.tensor([0.9])
    return rasterize(
        torch.tensor([mean]),
        torch.tensor([quat]),
        scales.log() if raw else scales,
        opacity.logit() if raw else opacity,
        sh,
        torch.eye(4)[None],
        torch.from_numpy(CAMERA.matrix()).float()[None],
        CAMERA.width,
        CAMERA.height,
        raw=raw,
        backend=backend,
    )


def moments(output: RenderOutput) -> tuple[np.ndarray, np.ndarray]:
    """Centre (x, y) and variance of what was drawn, pixel centres at +0.5."""
    weight = output.alpha[0].double().numpy()
    y, x = np.mgrid[: CAMERA.height, : CAMERA.width] + 0.5
    centre = np.array([(x * weight).sum(), (y * weight).sum()]) / weight.sum()
    spread = [((axis - c) ** 2 * weight).sum() for axis, c in zip((x, y), centre, strict=True)]
    return centre, np.array(spread) / weight.sum()


@BACKENDS
@pytest.mark.parametrize("mean", [(0.0, 0.0, 2.0), (0.31, -0.2, 2.0), (-0.4, 0.1, 1.5)])
def test_projection_is_opencvs_with_pixel_centres_at_half(
    backend: str, mean: tuple[float, float, float]
) -> None:
    expected = [
        CAMERA.fx * mean[0] / mean[2] + CAMERA.cx,
        CAMERA.fy * mean[1] / mean[2] + CAMERA.cy,
    ]
    np.testing.assert_allclose(moments(draw(backend, mean))[0], expected, atol=0.02)


@BACKENDS
def test_what_is_behind_the_camera_is_not_drawn(backend: str) -> None:
    output = draw(backend, (0.0, 0.0, -2.0))
    assert not bool(output.visible.any())
    assert float(output.alpha.max()) == 0


@BACKENDS
def test_quaternions_are_wxyz(backend: str) -> None:
    long, quarter = (0.2, 0.02, 0.02), (2**-0.5, 0.0, 0.0, 2**-0.5)  # 90 degrees about z
    flat = moments(draw(backend, (0, 0, 2.0), scale=long))[1]
    upright = moments(draw(backend, (0, 0, 2.0), scale=long, quat=quarter))[1]
    assert flat[0] > 4 * flat[1]
    assert upright[1] > 4 * upright[0]


@BACKENDS
def test_stored_scales_are_logarithms_and_opacities_logits(backend: str) -> None:
    stored = draw(backend, (0.1, 0.1, 2.0), raw=True)
    plain = draw(backend, (0.1, 0.1, 2.0), raw=False)
    torch.testing.assert_close(stored.image, plain.image, atol=1e-5, rtol=0)


@BACKENDS
def test_colours_are_blended_as_they_are(backend: str) -> None:
    output = draw(backend, (0, 0, 2.0), colour=0.25)
    expected = 0.25 * output.alpha[0][..., None].expand(-1, -1, 3)
    torch.testing.assert_close(output.image[0], expected, atol=1e-5, rtol=0)


def test_point_colours_become_the_constant_band() -> None:
    colors = np.array([[0, 128, 255], [10, 20, 30]], np.uint8)
    model = Gaussians.from_points(np.eye(3)[:2], colors)
    back = (model.sh[:, 0].numpy() * SH_C0 + 0.5) * 255
    np.testing.assert_allclose(back, colors, atol=1e-3)


@given(
    st.integers(1, 300),
    st.integers(1, 300),
    st.tuples(*[st.floats(-3, 3)] * 2, st.floats(0.1, 9)),
)
def test_a_resized_camera_sees_the_same_share_of_the_image(
    width: int, height: int, point: tuple[float, float, float]
) -> None:
    resized = CAMERA.resized(width, height)

    def share(camera: Camera) -> np.ndarray:
        pixel = camera.matrix() @ point
        return pixel[:2] / pixel[2] / (camera.width, camera.height)

    assert (resized.width, resized.height) == (width, height)
    np.testing.assert_allclose(share(resized), share(CAMERA), atol=1e-9)


def test_a_silhouette_holds_the_pixels_whose_centres_it_covers() -> None:
    camera = Camera(width=40, height=30, fx=10.0, fy=10.0, cx=20.0, cy=15.0)
    # The near face, at z = 1, spans columns 10.4 to 25.6 and rows 12.6 to 16.4.
    box = OrientedBox.between("b", [-0.96, -0.24, 1.0], [0.56, 0.14, 1.5])
    rows, columns = np.nonzero(box.silhouette(camera, np.eye(4)))
    assert (columns.min(), columns.max()) == (10, 25)
    assert (rows.min(), rows.max()) == (13, 15)
    assert len(rows) == 16 * 3


def test_the_world_is_the_models_frame(tmp_path: Path) -> None:
    project = write_project(tmp_path)
    scene = load_colmap(tmp_path, max_side=48)
    np.testing.assert_array_equal(np.sort(scene.points, axis=0), np.sort(project.points, axis=0))
    for name, pose in zip(project.names, project.poses, strict=True):
        np.testing.assert_allclose(scene.image(name).world_to_camera, pose, atol=1e-12)
        np.testing.assert_allclose(scene.image(name).forward, pose[2, :3], atol=1e-12)
        centre = scene.image(name).world_to_camera @ [*scene.image(name).centre, 1]
        np.testing.assert_allclose(centre[:3], 0, atol=1e-12)
    before = project.cameras[0]
    after = scene.images[0].camera
    np.testing.assert_allclose(
        [after.fx, after.fy, after.cx, after.cy], np.array(before.params) * after.width / 96
    )


# --- PLY ---


def arrays(count: int, bands: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(count + bands)
    shapes = {
        "means": (count, 3),
        "quats": (count, 4),
        "log_scales": (count, 3),
        "logit_opacities": (count,),
        "sh": (count, bands, 3),
    }
    return {name: rng.normal(size=shape).astype(np.float32) for name, shape in shapes.items()}


def header(path: Path) -> list[str]:
    return path.read_bytes().split(b"end_header\n")[0].decode("ascii").splitlines()


def test_ply_has_the_layout_that_viewers_read(tmp_path: Path) -> None:
    model, path = arrays(3, 16), tmp_path / "模型 (1).ply"
    write_ply(path, model)
    names = ["x", "y", "z", "nx", "ny", "nz", *(f"f_dc_{k}" for k in range(3))]
    names += [f"f_rest_{k}" for k in range(45)]
    names += ["opacity", *(f"scale_{k}" for k in range(3)), *(f"rot_{k}" for k in range(4))]
    assert header(path)[:3] == ["ply", "format binary_little_endian 1.0", "element vertex 3"]
    assert header(path)[3:] == [f"property float {name}" for name in names]
    body = path.read_bytes().split(b"end_header\n", 1)[1]
    table = np.frombuffer(body, "<f4").reshape(3, 62)
    assert (table[:, 3:6] == 0).all()
    np.testing.assert_array_equal(table[:, 9:24], model["sh"][:, 1:, 0])  # red comes first
    np.testing.assert_array_equal(table[:, 39:54], model["sh"][:, 1:, 2])
    np.testing.assert_array_equal(table[:, 54], model["logit_opacities"])
    np.testing.assert_array_equal(table[:, 58:], model["quats"])


@pytest.mark.parametrize("bands", [1, 4, 9, 16])
@pytest.mark.parametrize("count", [0, 1, 17])
def test_ply_comes_back_bit_for_bit(tmp_path: Path, count: int, bands: int) -> None:
    model = arrays(count, bands)
    if count:
        model["means"][0] = [np.nan, np.inf, -0.0]
    write_ply(tmp_path / "a.ply", model)
    for name, back in read_ply(tmp_path / "a.ply").items():
        assert back.shape == model[name].shape
        assert back.tobytes() == model[name].tobytes(), name


def test_ply_is_read_by_name(tmp_path: Path) -> None:
    model, path = arrays(5, 4), tmp_path / "a.ply"
    write_ply(path, model)
    head = header(path)
    names = [line.split()[-1] for line in head[3:]]
    body = path.read_bytes().split(b"end_header\n", 1)[1]
    table = dict(zip(names, np.frombuffer(body, "<f4").reshape(5, -1).T, strict=True))
    kept = [name for name in reversed(names) if not name.startswith("n")]
    dtype = np.dtype([("red", "u1"), *((name, "<f4") for name in kept)])
    rows = np.zeros(5, dtype)
    for name in kept:
        rows[name] = table[name]
    properties = ["property uchar red", *(f"property float {name}" for name in kept)]
    text = "\n".join([*head[:3], *properties, "end_header", ""])
    path.write_bytes(text.encode("ascii") + rows.tobytes())
    for name, back in read_ply(path).items():
        assert back.tobytes() == model[name].tobytes(), name


def _write_half(path: Path) -> None:
    with atomic_write(path) as file:
        file.write(b"half")
        raise ZeroDivisionError


def test_a_name_stands_for_a_whole_file(tmp_path: Path) -> None:
    path = tmp_path / "new folder" / "a.txt"
    with atomic_write(path) as file:
        file.write(b"first")
        assert not path.exists()
    with pytest.raises(ZeroDivisionError):
        _write_half(path)
    assert path.read_bytes() == b"first"
    assert [p.name for p in path.parent.iterdir()] == ["a.txt"]
