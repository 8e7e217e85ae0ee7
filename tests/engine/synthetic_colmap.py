"""Small COLMAP projects written by pycolmap: cameras on a ring, points around the origin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image

from roigs_engine.model.scene import SfmScene
from tests.poses import Y_DOWN, look_at

Array = np.ndarray


@dataclass(frozen=True, kw_only=True)
class Project:
    """The written project: names, (V, 4, 4) poses, (P, 3) points, cameras, photos' indices."""

    folder: Path
    names: list[str]
    poses: Array
    points: Array
    cameras: list[pycolmap.Camera]
    camera_of: list[int]

    def project(self, photo: int) -> Array:
        """(P, 2) pixels of the points on a photo as its (distorted) camera takes them; NaN: not."""
        pose = self.poses[photo]
        local = self.points @ pose[:3, :3].T + pose[:3, 3]
        return project(self.cameras[self.camera_of[photo]], local)


def camera(
    model: str = "PINHOLE",
    width: int = 96,
    height: int = 72,
    params: Sequence[float] | None = None,
) -> pycolmap.Camera:
    """A pycolmap camera; by default fx != fy and the principal point off the centre."""
    if params is None:
        params = [100.0, 90.0, width * 0.47, height * 0.55]
    return pycolmap.Camera(model=model, width=width, height=height, params=list(params))


def project(cam: pycolmap.Camera, local: Array) -> Array:
    """(P, 3) in the camera's frame -> (P, 2) pixels, NaN outside the image."""
    pixels = np.full((len(local), 2), np.nan)
    for row, point in enumerate(local):
        pixel = cam.img_from_cam(point)
        if pixel is not None and (pixel >= 0).all() and (pixel < (cam.width, cam.height)).all():
            pixels[row] = pixel
    return pixels


def ring(count: int, arc: float = 2 * np.pi, radius: float = 4.0, height: float = -1.0) -> Array:
    """(count, 4, 4) poses on a ring (or an arc of it) around the origin, all looking at it."""
    angles = arc * np.arange(count) / max(count, 1)
    centres = np.stack([radius * np.sin(angles), np.full(count, height), -radius * np.cos(angles)])
    return np.array([look_at(centre, up=Y_DOWN) for centre in centres.T]).reshape(-1, 4, 4)


def paint(cam: pycolmap.Camera, pixels: Array, sigma: float = 1.5) -> Array:
    """(H, W, 3) uint8: a Gaussian dot at each (x, y), pixel centres at +0.5, on dark grey."""
    y, x = np.mgrid[: cam.height, : cam.width] + 0.5
    photo = np.full((cam.height, cam.width), 20.0)
    for px, py in pixels[np.isfinite(pixels).all(axis=1)]:
        photo += 220 * np.exp(-((x - px) ** 2 + (y - py) ** 2) / (2 * sigma**2))
    return np.repeat(photo.clip(0, 255).round().astype(np.uint8)[..., None], 3, axis=2)


def write_project(
    folder: Path,
    *,
    names: Sequence[str] = ("a.png", "b.png", "c.png"),
    cameras: Sequence[pycolmap.Camera] = (),
    points: Array | None = None,
    binary: bool = True,
    rigs: bool = True,
    model: str = "sparse/0",
    images: str | None = "images",
    tracks: bool = True,
    dots: bool = False,
    arc: float = 2 * np.pi,
) -> Project:
    """Write model and photos.

    Args:
        names: one photo each; photo i has camera i modulo their number.
        points: (P, 3), default 40 random ones in [-0.8, 0.8]^3.
        rigs: keep rigs and frames beside the model's three old files.
        model, images: subfolders; `images=None` writes no photos.
        tracks: store which photo observes which point.
        dots: photos show the points as dots, else a flat colour.
        arc: share of the ring that the cameras stand on, radians.
    """
    cams = list(cameras) or [camera()]
    if points is None:
        points = np.random.default_rng(7).uniform(-0.8, 0.8, (40, 3))
    project_ = Project(
        folder=folder,
        names=list(names),
        poses=ring(len(names), arc),
        points=points,
        cameras=cams,
        camera_of=[index % len(cams) for index in range(len(names))],
    )
    _write_model(project_, folder / model, binary, tracks)
    if not rigs:
        for path in (folder / model).glob("[rf][ir][ga]*s.*"):  # rigs.*, frames.*
            path.unlink()
    for index, name in enumerate(names if images is not None else ()):
        cam = cams[project_.camera_of[index]]
        pixels = project_.project(index) if dots else np.empty((0, 2))
        path = folder / str(images) / name
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(paint(cam, pixels)).save(path)
    return project_


def _write_model(project_: Project, folder: Path, binary: bool, tracks: bool) -> None:
    reconstruction = pycolmap.Reconstruction()
    for index, cam in enumerate(project_.cameras):
        cam.camera_id = index + 1
        reconstruction.add_camera_with_trivial_rig(cam)
    observers: list[list[pycolmap.TrackElement]] = [[] for _ in project_.points]
    for index, name in enumerate(project_.names):
        pixels = project_.project(index)
        seen = np.flatnonzero(np.isfinite(pixels).all(axis=1)) if tracks else np.empty(0, int)
        image = pycolmap.Image(
            name=name,
            image_id=index + 1,
            camera_id=project_.camera_of[index] + 1,
            points2D=pycolmap.Point2DList([pycolmap.Point2D(pixels[row]) for row in seen]),
        )
        pose = pycolmap.Rigid3d(project_.poses[index][:3])
        reconstruction.add_image_with_trivial_frame(image, pose)
        for place, row in enumerate(seen):
            observers[row].append(pycolmap.TrackElement(index + 1, place))
    for row, point in enumerate(project_.points):
        track = pycolmap.Track(elements=observers[row])
        reconstruction.add_point3D(point, track, np.array([row % 256, 100, 200], np.uint8))
    folder.mkdir(parents=True, exist_ok=True)
    (reconstruction.write_binary if binary else reconstruction.write_text)(str(folder))


def assert_same(scene: SfmScene, project: Project, names: list[str] | None = None) -> None:
    """Poses, points and observations are those that were written."""
    names = project.names if names is None else names
    assert [image.name for image in scene.images] == sorted(names)
    np.testing.assert_allclose(scene.points, project.points, atol=1e-12)
    for image in scene.images:
        index = project.names.index(image.name)
        np.testing.assert_allclose(image.world_to_camera, project.poses[index], atol=1e-12)
        seen = np.flatnonzero(np.isfinite(project.project(index)).all(axis=1))
        np.testing.assert_array_equal(image.point_indices, seen)
