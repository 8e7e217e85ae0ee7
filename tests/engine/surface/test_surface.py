"""A ball's mesh from exact depth maps: where it is, what is cleaned away, its texture and files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.context import Context
from roigs_engine.errors import SceneError
from roigs_engine.formats.events import Progress, StageStarted
from roigs_engine.model.local_frame import LocalFrame
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import PhotoMask, PosedImage
from roigs_engine.photos.mask_images import write_mask
from roigs_engine.surface.depth import DepthMap
from roigs_engine.surface.files import convert_mesh, write_mesh
from roigs_engine.surface.fusion import fuse, slopes
from roigs_engine.surface.mesh import Mesh, mesh_of, simplified
from roigs_engine.surface.photo_fit import fitted
from roigs_engine.surface.texture import Textured, _texels, textured
from tests.engine.surface.ball import BOX, CAMERA, RADIUS, colour_at, depth_map, images, photo
from tests.poses import look_at

trimesh = pytest.importorskip("trimesh")
pytest.importorskip("skimage")
VOXEL = 0.02
SMALL = np.zeros((0, 0), np.uint8)  # of a mask: unused here
FRAME = LocalFrame(origin=np.array([4.0, 0, 0]), scale=16.0)
UPRIGHT = np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]], float)  # x is up


@pytest.fixture(scope="module")
def maps() -> list[DepthMap]:
    return [depth_map(image) for image in images()]


@pytest.fixture(scope="module")
def ball(maps: list[DepthMap]) -> Mesh:
    return mesh_of(fuse(maps, BOX, VOXEL), BOX, maps)


def test_the_mesh_is_where_the_ball_is(ball: Mesh) -> None:
    away = np.linalg.norm(ball.vertices, axis=1) - RADIUS
    assert abs(np.median(away)) < 0.1 * VOXEL
    assert np.abs(away).max() < VOXEL
    assert ball.is_closed() and not ball.filled.any()
    assert ball.volume() == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.02)
    assert ((ball.normals() * ball.vertices).sum(axis=1) / RADIUS > 0.97).all()


def test_a_hole_has_the_area_that_is_missing(ball: Mesh) -> None:
    half = ball.kept(ball.vertices[ball.faces].mean(axis=1)[:, 2] > 0)
    assert half.holes() == pytest.approx(np.array([[0, 0, -np.pi * RADIUS**2]]), abs=0.03)
    assert not len(ball.holes())


def test_the_slope_of_a_plane_is_exact() -> None:
    normal = np.array([0.3, -0.4, -1.0]) / np.linalg.norm([0.3, -0.4, -1.0])
    x = (np.arange(CAMERA.width) + 0.5 - CAMERA.cx) / CAMERA.fx
    y = (np.arange(CAMERA.height) + 0.5 - CAMERA.cy) / CAMERA.fy
    rays = np.stack([*np.meshgrid(x, y), np.ones((CAMERA.height, CAMERA.width))], axis=-1)
    depth = (-2.0 / (rays @ normal)).astype(np.float32)
    slope, facing = slopes(depth, CAMERA)
    inner = slice(5, -5), slice(5, -5)
    assert slope[inner] == pytest.approx(np.abs(rays @ normal)[inner], abs=1e-3)
    assert (facing <= 1.0 + 1e-6).all()


def test_fusion_tells_how_far_it_is(maps: list[DepthMap]) -> None:
    """A bar that stands still looks like a program that does."""
    events: list[object] = []
    fuse(maps, BOX, VOXEL, Context(emit=events.append))
    (total,) = (event.total for event in events if isinstance(event, StageStarted))
    steps = [event.step for event in events if isinstance(event, Progress)]
    assert steps == sorted(steps) and steps[-1] == total
    assert max(np.diff(steps)) <= total // 4


def test_wrong_depths_of_a_few_photos_make_no_layer(maps: list[DepthMap], ball: Mesh) -> None:
    """Through a hole in the surface, three photos see something inside the ball."""
    wrong = []
    for number, each in enumerate(maps):
        depth = each.depth.copy()
        if number in (3, 9, 15):
            depth[36:44, 44:52] += 0.4
        wrong.append(replace(each, depth=depth))
    found = mesh_of(fuse(wrong, BOX, VOXEL), BOX, wrong)
    away = np.abs(np.linalg.norm(found.vertices, axis=1) - RADIUS)
    assert len(np.unique(found.parts())) == 1
    assert away.max() < 2 * VOXEL


def test_close_photos_do_not_fill_the_air_behind_what_they_show() -> None:
    """A floor that twelve photos show; six more stand there, close to something of their own."""
    flat = OrientedBox.between("floor", [-0.5, -0.5, -0.2], [0.5, 0.5, 1.0])
    maps = [floor_map((2 * np.cos(a), 2 * np.sin(a), 1.6)) for a in np.arange(12) * np.pi / 6]
    for place in np.linspace(-0.5, 0.5, 6):
        close = floor_map((place, 0.1, 2.0))
        maps.append(replace(close, depth=np.full_like(close.depth, 0.2)))
    mesh = mesh_of(fuse(maps, flat, 0.05), flat, maps)
    assert np.abs(mesh.vertices[:, 2]).max() < 0.05
    assert mesh.areas.sum() > 0.9


def floor_map(eye: tuple[float, float, float]) -> DepthMap:
    """The depth map of a perfect model of the plane z = 0."""
    image = replace(images(1)[0], world_to_camera=look_at(eye, (0, 0, 0)))
    camera, pose = image.camera, image.world_to_camera
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    rays = np.stack([*np.meshgrid(x, y), np.ones((camera.height, camera.width))], axis=-1)
    depth = (-eye[2] / (rays @ pose[:3, 2])).astype(np.float32)
    return DepthMap(image=image, x=0, y=0, camera=camera, depth=depth, weight=np.ones_like(depth))


def test_a_field_with_half_the_voxels_has_the_same_surface() -> None:
    maps = [depth_map(image) for image in images()]
    field = fuse(maps, BOX, VOXEL)
    half = field.halved()
    assert half.voxel == 2 * field.voxel and half.distance.size < field.distance.size / 6
    meshes = [mesh_of(each, BOX, maps, closed=True) for each in (field, half)]
    for each, mesh in zip((field, half), meshes, strict=True):
        assert len(mesh.faces) / 2 < each.faces < 2 * len(mesh.faces)
    radii = [np.linalg.norm(mesh.vertices - BOX.centre, axis=1) for mesh in meshes]
    assert abs(np.median(radii[0]) - np.median(radii[1])) < field.voxel / 4
    assert meshes[1].is_closed()


def test_what_no_photo_shows_stays_open_or_is_filled() -> None:
    """Photos from above alone: the lower part is a hole, or closed and marked."""
    above = [depth_map(image) for image in images() if image.centre[2] > 0.5]
    field = fuse(above, BOX, VOXEL)
    open_mesh, closed = mesh_of(field, BOX, above), mesh_of(field, BOX, above, closed=True)
    assert not open_mesh.is_closed()
    assert closed.is_closed() and 0.1 < closed.filled.mean() < 0.9
    few = simplified(closed, 4000)
    assert len(few.faces) < len(closed.faces)
    assert trimesh.Trimesh(few.vertices, few.faces, process=False).is_watertight


def test_the_mesh_ends_where_photos_end() -> None:
    """Photos from one side: nothing goes on along their last rays, behind the ball."""
    maps = [depth_map(image) for image in images(60) if image.centre[0] > 1.2]
    mesh = mesh_of(fuse(maps, BOX, VOXEL), BOX, maps)
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - RADIUS).max() < 2 * VOXEL


def test_what_simplifying_cuts_off_is_removed() -> None:
    """A small sheet that touches a large one with a corner."""
    x, y = np.mgrid[0:40, 0:40]
    large = np.stack([x, y, 0.1 * np.sin(1.7 * x + y)], axis=-1).reshape(-1, 3)
    small = large[(x < 4).ravel() & (y < 4).ravel()] / 10 + (39, 39, 0)
    quads = [
        (i * n + j + k, n)
        for n, k in ((40, 0), (4, 1599))
        for i in range(n - 1)
        for j in range(n - 1)
    ]
    faces = [face for a, n in quads for face in ((a, a + n, a + 1), (a + 1, a + n, a + n + 1))]
    corners = np.array(faces, dtype=np.int64)
    mesh = Mesh(
        vertices=np.concatenate([large, small[1:]]),
        faces=corners,
        filled=np.zeros(len(corners), bool),
    )
    assert len(np.unique(mesh.parts())) == 1
    assert len(np.unique(simplified(mesh, 1000).parts())) == 1


def test_an_empty_box_is_said() -> None:
    empty = [replace(m, depth=np.full_like(m.depth, 8.0)) for m in map(depth_map, images(6))]
    with pytest.raises(SceneError, match="No photo shows a surface in box 'ball'"):
        mesh_of(fuse(empty, BOX, VOXEL), BOX, empty)


@pytest.fixture(scope="module")
def coloured(maps: list[DepthMap], ball: Mesh) -> Textured:
    """From photos half of which are darker."""
    gains = {m.image.name: (0.8, 1.0)[k % 2] for k, m in enumerate(maps)}
    return textured(simplified(ball, 4000), maps, 256, lambda i: photo(i, gains[i.name]))


def test_the_texture_has_the_photos_colours(coloured: Textured) -> None:
    assert coloured.seen > 0.99
    charts = coloured.charts
    middle = charts.texels[charts.faces].mean(axis=1).astype(int)
    found = coloured.picture[middle[:, 1], middle[:, 0]].astype(float)
    wanted = colour_at(coloured.mesh.vertices[coloured.mesh.faces].mean(axis=1))
    ratio = found.sum() / wanted.sum()  # the exposure between both kinds of photos
    assert 0.8 < ratio < 1.0
    assert np.median(np.abs(found - wanted * ratio)) < 4
    assert np.percentile(np.abs(found - wanted * ratio), 95) < 12


def test_ignored_pixels_colour_nothing(maps: list[DepthMap], ball: Mesh, tmp_path: Path) -> None:
    """As of somebody in front of the object: masks hide them, Gaussians do not show them."""
    hidden = np.zeros((CAMERA.height, CAMERA.width), bool)
    hidden[:, 30:55] = True
    write_mask(tmp_path / "mask.png", ~hidden)
    mask = PhotoMask(digest="m", path=tmp_path / "mask.png", remake=lambda: None, small=SMALL)
    masked = [replace(m, image=replace(m.image, mask=mask)) for m in maps]

    def passer_by(image: PosedImage) -> np.ndarray:
        return np.where(hidden[..., None], np.uint8([255, 0, 255]), photo(image))

    simple = simplified(ball, 4000)
    clean = textured(simple, masked, 256, photo)
    assert clean.seen > 0.9
    same = textured(simple, masked, 256, passer_by)
    assert np.abs(same.picture.astype(int) - clean.picture).max() <= 1  # a blur reaches over
    fits = [fitted(simple, masked, BOX, load).vertices for load in (photo, passer_by)]
    np.testing.assert_allclose(*fits, atol=1e-3)


def test_a_place_far_from_the_origin_gets_its_own_colours(coloured: Textured) -> None:
    """A texel at a face's border is on the face, however far away that is."""
    share = _texels(coloured.charts)[2]
    assert share.sum(axis=1) == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize(("ending", "up"), [("obj", 1), ("ply", 2), ("stl", 2), ("glb", 1)])
def test_files_are_read_by_others(coloured: Textured, tmp_path: Path, ending: str, up: int) -> None:
    """The ball lies 4 units along the world's x axis, which points up."""
    glb, path = tmp_path / "ball.glb", tmp_path / f"other.{ending}"
    write_mesh(glb, coloured, FRAME, UPRIGHT)
    assert convert_mesh(glb, path) == len(coloured.mesh.faces)
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    convert_mesh(glb, path)
    assert before == {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    mesh = trimesh.load(path, force="mesh")
    assert len(mesh.faces) == len(coloured.mesh.faces)
    assert mesh.bounds.mean(axis=0) == pytest.approx(4 * np.eye(3)[up], abs=0.01)
    assert mesh.extents == pytest.approx([RADIUS / 8] * 3, rel=0.05)
    if ending != "stl":  # in the colours of the photos: red towards x
        colours = mesh.visual if ending == "ply" else mesh.visual.to_color()
        red = np.asarray(colours.vertex_colors)[:, 0].astype(float)
        assert np.corrcoef(red, mesh.vertices[:, up])[0, 1] > 0.95


@pytest.mark.parametrize("ending", ["usda", "usdc", "usdz"])
def test_open_usd_has_the_texture(coloured: Textured, tmp_path: Path, ending: str) -> None:
    usd, shade = pytest.importorskip("pxr.Usd"), pytest.importorskip("pxr.UsdShade")
    glb, path = tmp_path / "ball.glb", tmp_path / f"other.{ending}"
    write_mesh(glb, coloured, FRAME, UPRIGHT)
    convert_mesh(glb, path)
    stage = usd.Stage.Open(str(path))
    mesh = stage.GetDefaultPrim()
    points = np.array(mesh.GetAttribute("points").Get())
    assert len(mesh.GetAttribute("faceVertexCounts").Get()) == len(coloured.mesh.faces)
    assert np.ptp(points, axis=0) == pytest.approx([RADIUS / 8] * 3, rel=0.05)
    assert points.mean(axis=0) == pytest.approx([0, 4, 0], abs=0.02)
    material = shade.MaterialBindingAPI(mesh).ComputeBoundMaterial()[0]
    assert material.ComputeSurfaceSource()[0].GetPrim().GetName() == "Surface"
    picture = stage.GetPrimAtPath("/Mesh/Photos/Texture").GetAttribute("inputs:file").Get()
    assert Path(picture.resolvedPath.split("[")[0]).is_file()
