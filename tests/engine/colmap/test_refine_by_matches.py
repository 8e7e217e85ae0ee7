"""Cameras are fitted to what photos show: keypoints miss their points by half a pixel.

The photos show a roof, two textured planes, so everything about them is known.
"""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from PIL import Image

from roigs_engine.cli import main
from roigs_engine.colmap.adjustment import has_rigs, is_sound, with_cameras_of, with_own_cameras
from roigs_engine.colmap.project import load_colmap
from roigs_engine.colmap.refine import Refinement, _write, refine_cameras
from roigs_engine.colmap.refine_by_matches import fit_to_matches
from roigs_engine.colmap.track_matching import PhotoFile
from roigs_engine.context import QUIET, Context
from roigs_engine.errors import SceneError, Stopped
from roigs_engine.formats.events import Event, Message
from tests.engine.synthetic_colmap import Project, camera, write_project

SLOPE = 0.5  # the roof: z = SLOPE |x|
NAMES = [f"walk/{k:02}.png" for k in range(10)]
NAMES[3] = "walk/03 a\nb #1.png"  # no text can hold it
LENS = [300.0, 290.0, 160.0, 120.0, 0.06, -0.03, 0.0, 0.0]
NOISE = 0.5  # px, of the keypoints


def points() -> np.ndarray:
    """(P, 3) on the roof."""
    x, y = np.random.default_rng(3).uniform(-1, 1, (2, 300)) * [[1.2], [0.9]]
    return np.stack([x, y, SLOPE * np.abs(x)], axis=1)


def shown(project: Project, photo: int, lens: pycolmap.Camera) -> np.ndarray:
    """(H, W) what a camera sees of the roof."""
    y, x = np.mgrid[: lens.height, : lens.width] + 0.5
    rays = np.asarray(lens.cam_from_img(np.stack([x, y], axis=-1).reshape(-1, 2)))
    pose = project.poses[photo]
    rays = np.column_stack([rays[:, :2], np.ones(len(rays))]) @ pose[:3, :3]
    centre = -pose[:3, :3].T @ pose[:3, 3]
    grey = np.full(len(rays), 127.0)
    nearest = np.full(len(rays), np.inf)
    for side in (-1, 1):
        away = (SLOPE * side * centre[0] - centre[2]) / (rays[:, 2] - SLOPE * side * rays[:, 0])
        hit = centre + away[:, None] * rays
        seen = (away > 0) & (hit[:, 0] * side >= 0) & (away < nearest)
        grey[seen], nearest[seen] = texture(hit[seen, 0], hit[seen, 1]), away[seen]
    return grey.reshape(lens.height, lens.width)


def texture(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Grey values, in numbers of half the length: a tenth of the time."""
    rng = np.random.default_rng(8)
    x, y = x.astype(np.float32), y.astype(np.float32)
    value = np.full(x.shape, 127, np.float32)
    for _ in range(40):
        fx, fy = rng.normal(scale=26, size=2)  # per unit: a pixel is a seventieth
        value += 11 * np.sin(
            np.float32(fx) * x + np.float32(fy) * y + np.float32(rng.uniform(0, 6))
        )
    return value


def captured(folder: Path, *, zoom: float = 0.0) -> Project:
    """A project with these photos, and a model that was fitted to keypoints with noise.

    Args:
        folder: of the project.
        zoom: how much the photos' focal lengths differ, as a share.
    """
    lens = camera("OPENCV", 320, 240, LENS)
    made = write_project(folder, names=NAMES, cameras=[lens], points=points(), arc=1.6)
    rng = np.random.default_rng(5)
    model = folder / "sparse" / "0"
    scene = pycolmap.Reconstruction(str(model))
    for image in sorted(scene.images.values(), key=lambda image: image.name):
        factor = 1 + zoom * rng.uniform(-1, 1)
        own = camera("OPENCV", 320, 240, [LENS[0] * factor, LENS[1] * factor, *LENS[2:]])
        row = NAMES.index(image.name)
        grey = shown(made, row, own).clip(0, 255).round().astype(np.uint8)
        Image.fromarray(np.repeat(grey[..., None], 3, axis=2)).save(folder / "images" / image.name)
        pose = image.cam_from_world()
        for keypoint in image.points2D:
            place = own.img_from_cam(pose * scene.points3D[keypoint.point3D_id].xyz)
            keypoint.xy = place + rng.normal(scale=NOISE, size=2)
    config = pycolmap.BundleAdjustmentConfig()
    for key in scene.reg_image_ids():
        config.add_image(key)
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    pycolmap.create_default_bundle_adjuster(options, config, scene).solve()
    keys = sorted(scene.point3D_ids())
    scene.transform(
        pycolmap.estimate_sim3d(np.array([scene.points3D[key].xyz for key in keys]), points())
    )
    scene.write(str(model))
    return made


def inconsistency(model: Path, made: Project) -> float:
    """Disagreement of cameras about common places, px: mean over photos."""
    scene = pycolmap.Reconstruction(str(model))
    misses: dict[str, list[np.ndarray]] = {name: [] for name in NAMES}
    truth = [made.project(row) for row in range(len(NAMES))]
    for point in range(0, len(points()), 5):
        rows, places = [], []
        for image in scene.images.values():
            place = truth[NAMES.index(image.name)][point]
            if np.isfinite(place).all():
                rows.append(image)
                places.append(place)
        equations = []
        for image, place in zip(rows, places, strict=True):
            matrix = np.asarray(image.cam_from_world().matrix())
            ray = np.asarray(image.camera.cam_from_img(place[None]))[0]
            equations += [ray[k] * matrix[2] - matrix[k] for k in range(2)]
        position = np.linalg.svd(np.array(equations))[2][-1]
        for image, place in zip(rows, places, strict=True):
            misses[image.name].append(image.project_point(position[:3] / position[3]) - place)
    return float(np.mean([np.linalg.norm(np.mean(own, axis=0)) for own in misses.values()]))


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Project]:
    folder = tmp_path_factory.mktemp("roof")
    return folder, captured(folder)


@pytest.fixture(scope="module")
def refined(
    scene: tuple[Path, Project], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, Refinement]:
    """The model that is made of the scene's, and what was said of it."""
    new = tmp_path_factory.mktemp("refined") / "new"
    return new, refine_cameras(scene[0] / "sparse" / "0", new)


def test_cameras_agree_several_times_as_well_and_names_stay(
    scene: tuple[Path, Project], refined: tuple[Path, Refinement], tmp_path: Path
) -> None:
    folder, made = scene
    old = folder / "sparse" / "0"
    by_tracks = refine_cameras(old, tmp_path / "tracks", look=False)
    assert by_tracks.matched is None
    new, done = refined
    assert done.better and done.matched is not None and "poses" in done.matched.changed
    assert done.matched.photos == len(NAMES)
    assert done.matched.after < 0.1 and done.matched.after < done.matched.before / 1.5
    tracks = tmp_path / "tracks" if by_tracks.better else old
    assert inconsistency(new, made) < inconsistency(tracks, made) / 2
    before, after = (
        load_colmap(model, pixels=False, images=folder / "images")
        for model in (
            old,
            new,
        )
    )
    assert [image.name for image in after.images] == NAMES
    for one, other in zip(before.images, after.images, strict=True):
        assert np.array_equal(one.point_indices, other.point_indices)
    moved = (np.linalg.norm(s.points - points(), axis=1) for s in (before, after))
    assert np.median(next(moved)) > np.median(next(moved))


def test_photos_get_focal_lengths_of_their_own_only_if_that_fits_better(
    refined: tuple[Path, Refinement], tmp_path: Path
) -> None:
    _, done = refined
    assert done.matched is not None and "focal lengths" not in done.matched.changed
    captured(tmp_path / "zoomed", zoom=0.01)
    done = refine_cameras(tmp_path / "zoomed" / "sparse" / "0", tmp_path / "new")
    assert done.matched is not None and "focal lengths" in done.matched.changed
    model = pycolmap.Reconstruction(str(tmp_path / "new"))
    assert len({image.camera_id for image in model.images.values()}) == len(NAMES)
    assert {image.name for image in model.images.values()} == set(NAMES)


def test_without_photos_only_tracks_are_used(scene: tuple[Path, Project], tmp_path: Path) -> None:
    said: list[Event] = []
    shutil.copytree(scene[0] / "sparse" / "0", tmp_path / "model")
    done = refine_cameras(tmp_path / "model", tmp_path / "new", Context(emit=said.append))
    assert done.matched is None
    texts = [event.text for event in said if isinstance(event, Message)]
    assert any("only the tracks are used" in text for text in texts)


def test_a_photo_that_is_damaged_or_missing_is_left_out(
    scene: tuple[Path, Project], tmp_path: Path
) -> None:
    shutil.copytree(scene[0], tmp_path / "project")
    images = tmp_path / "project" / "images"
    whole = (images / NAMES[3]).read_bytes()
    (images / NAMES[3]).write_bytes(whole[: len(whole) // 2])
    (images / NAMES[6]).unlink()
    said: list[Event] = []
    context = Context(emit=said.append)
    done = refine_cameras(tmp_path / "project/sparse/0", tmp_path / "new", context)
    assert sum("walk/03" in getattr(event, "text", "") for event in said) == 1
    assert done.matched is not None and done.matched.photos == len(NAMES) - 2
    model = pycolmap.Reconstruction(str(tmp_path / "new"))
    assert {image.name for image in model.images.values()} == set(NAMES)


def test_it_can_be_stopped(scene: tuple[Path, Project], tmp_path: Path) -> None:
    seen: list[Event] = []

    def stop() -> bool:
        return any(getattr(event, "stage", "") == "match points" for event in seen)

    with pytest.raises(Stopped):
        refine_cameras(
            scene[0] / "sparse" / "0",
            tmp_path / "new",
            Context(emit=seen.append, should_stop=stop),
        )
    assert not (tmp_path / "new").exists()


def test_the_command_says_what_it_did(
    refined: tuple[Path, Refinement],
    scene: tuple[Path, Project],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    model, (new, done) = str(scene[0] / "sparse" / "0"), refined
    tracks = replace(done, matched=None)

    def quick(*_: object, look: bool, **__: object) -> Refinement:
        return done if look else tracks

    monkeypatch.setattr("roigs_engine.colmap.refine.refine_cameras", quick)
    assert main(["refine-cameras", model, "--out", str(new)]) == 0
    out = capsys.readouterr().out
    assert "places matched in 10 photos" in out and "changed" in out
    assert main(["refine-cameras", model, "--tracks-only", "--out", str(new)]) == 0
    assert "matched" not in capsys.readouterr().out
    monkeypatch.undo()
    assert main(["refine-cameras", model, "--images", str(new / "no")]) == 2


def test_photos_that_show_nothing_are_not_used(
    scene: tuple[Path, Project], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(scene[0], tmp_path / "project")
    for photo in (tmp_path / "project" / "images" / "walk").iterdir():
        Image.new("RGB", (320, 240), (90, 90, 90)).save(photo)
    (tmp_path / "project" / "images" / "walk" / "04.png").write_bytes(b"")
    main(["refine-cameras", str(tmp_path / "project"), "--out", str(tmp_path / "new")])
    said = capsys.readouterr()
    assert "Only 0 places matched in the photos: they were not used." in said.out
    assert "1 photo not used" in said.err and "walk/04.png" in said.err


def test_a_lens_must_be_one_to_one_in_its_picture() -> None:
    mild = [1100.0, 1092.0, 640.0, 360.0, -3.34, 15.67, 0.0, 0.0, 74.3, -3.5, 16.19, 71.75]
    pole = [300.0, 300.0, 160.0, 120.0, 0.695, -4.98, 0.0, 0.0, -15.39, 0.682, -5.13, -14.84]
    fold = [300.0, 300.0, 160.0, 120.0, -1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert is_sound(camera("FULL_OPENCV", 1280, 720, mild))
    assert not is_sound(camera("FULL_OPENCV", 640, 428, pole))
    assert not is_sound(camera("FULL_OPENCV", 320, 240, fold))
    assert is_sound(camera("OPENCV", 320, 240, LENS))


def test_a_full_disk_is_an_error(scene: tuple[Path, Project], tmp_path: Path) -> None:
    """pycolmap writes what fits, and says nothing."""

    class Full:
        def __init__(self) -> None:
            self.scene = pycolmap.Reconstruction(str(scene[0] / "sparse" / "0"))
            self.num_reg_images = self.scene.num_reg_images
            self.num_points3D = self.scene.num_points3D

        def write(self, folder: str) -> None:
            self.scene.write(folder)
            (Path(folder) / "points3D.bin").write_bytes(b"")

    with pytest.raises(SceneError, match="too short"):
        _write(Full(), tmp_path / "new")
    assert not list(tmp_path.iterdir())


def on_a_rig(flat: pycolmap.Reconstruction, made: Project) -> pycolmap.Reconstruction:
    """The scene with its photos taken in pairs, by two cameras that are fixed to each other.

    On a ring, a camera and the next are always the same way apart. Here that is a little wrong.
    """
    first, second = (made.poses[row] for row in range(2))
    apart = (second @ np.linalg.inv(first))[:3]
    apart[:, 3] += 0.01
    kind = pycolmap.SensorType.CAMERA
    one, two = (pycolmap.sensor_t(type=kind, id=key) for key in (1, 2))
    scene, rig = pycolmap.Reconstruction(), pycolmap.Rig(rig_id=1)
    for key in (1, 2):
        lens = camera("OPENCV", 320, 240, LENS)
        lens.camera_id = key
        scene.add_camera(lens)
    rig.add_ref_sensor(one)
    rig.add_sensor(two, pycolmap.Rigid3d(apart))
    scene.add_rig(rig)
    for row in range(0, len(NAMES), 2):
        frame = pycolmap.Frame(frame_id=row // 2 + 1, rig_id=1)
        for sensor, key in ((one, row + 1), (two, row + 2)):
            frame.add_data_id(pycolmap.data_t(sensor_id=sensor, id=key))
        frame.rig_from_world = pycolmap.Rigid3d(made.poses[row][:3])
        scene.add_frame(frame)
    for key, image in sorted(flat.images.items()):
        keypoints = pycolmap.Point2DList([pycolmap.Point2D(k.xy) for k in image.points2D])
        sensor = 1 + (key - 1) % 2
        copy = pycolmap.Image(name=image.name, image_id=key, camera_id=sensor, points2D=keypoints)
        copy.frame_id = (key - 1) // 2 + 1
        scene.add_image(copy)
    for key in scene.frames:
        scene.register_frame(key)
    for key, point in flat.points3D.items():  # the true places, like the poses
        scene.add_point3D(points()[key - 1], pycolmap.Track(list(point.track.elements)))
    return scene


def test_cameras_on_a_rig_stay_on_it(scene: tuple[Path, Project]) -> None:
    rig = on_a_rig(pycolmap.Reconstruction(str(scene[0] / "sparse" / "0")), scene[1])
    names = [image.name for _, image in sorted(rig.images.items())]
    photos = [PhotoFile(scene[0] / "images" / name, turn=1) for name in names]
    fitted, fit = fit_to_matches(pycolmap, rig, photos, QUIET)
    assert fit.changed and "focal lengths" not in fit.changed and fit.after < fit.before
    carried = with_cameras_of(pycolmap, rig, fitted, 1.0)
    assert has_rigs(carried) and len(carried.frames) == len(NAMES) // 2
    for key, image in carried.images.items():
        expected = fitted.images[key].cam_from_world().matrix()
        assert np.allclose(image.cam_from_world().matrix(), expected, atol=1e-12)


def test_own_cameras_keep_points_and_tracks(scene: tuple[Path, Project]) -> None:
    before = pycolmap.Reconstruction(str(scene[0] / "sparse" / "0"))
    after = with_own_cameras(pycolmap, before, {1, 4})
    assert after.images[1].camera_id != after.images[4].camera_id
    assert after.images[2].camera_id == before.images[2].camera_id
    assert np.allclose(after.images[1].camera.params, before.images[1].camera.params)
    assert sorted(after.point3D_ids()) == sorted(before.point3D_ids())
    assert after.compute_num_observations() == before.compute_num_observations()
