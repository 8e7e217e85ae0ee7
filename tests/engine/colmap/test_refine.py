"""Cameras with the wrong lens model are found again from the tracks; what is good stays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap
import pytest

from roigs_engine.cli import main
from roigs_engine.colmap import adjustment
from roigs_engine.colmap.project import load_colmap
from roigs_engine.colmap.refine import refine_cameras
from roigs_engine.context import Context
from roigs_engine.errors import SceneError, Stopped
from roigs_engine.formats.projects import refined_folder
from tests.engine.colmap.bent_models import LENS, NAMES, POINTS, bent, positions
from tests.engine.synthetic_colmap import camera, write_project


def centres(model: Path) -> np.ndarray:
    """(V, 3) camera centres in the order of the photos' names."""
    images = pycolmap.Reconstruction(str(model)).images.values()
    return np.array([i.projection_center() for i in sorted(images, key=lambda image: image.name)])


def test_the_true_cameras_are_found_and_the_world_stays(tmp_path: Path) -> None:
    made = bent(tmp_path)
    old, new = tmp_path / "sparse" / "0", tmp_path / "sparse" / "refined"
    done = refine_cameras(old, new)
    assert done.better and done.cameras == 1
    assert done.after < 0.07 < 0.08 < done.before  # keypoints are 0.05 px off in x and y
    truth = np.array([-pose[:3, :3].T @ pose[:3, 3] for pose in made.poses])
    before, after = (np.linalg.norm(centres(m) - truth, axis=1).max() for m in (old, new))
    assert after < before / 2
    refined = pycolmap.Reconstruction(str(new))
    lens = refined.cameras[1]
    assert lens.model.name == "OPENCV" and np.allclose(lens.params[4:6], LENS[4:6], atol=0.1)
    assert np.median(np.linalg.norm(positions(refined) - POINTS, axis=1)) < 0.01


def test_photos_tracks_and_points_are_the_same(tmp_path: Path) -> None:
    bent(tmp_path)
    old, new = tmp_path / "sparse" / "0", tmp_path / "sparse" / "refined"
    refine_cameras(old, new)
    before, after = (load_colmap(model, pixels=False) for model in (old, new))
    assert [i.name for i in before.images] == [i.name for i in after.images]
    for one, other in zip(before.images, after.images, strict=True):
        assert np.array_equal(one.point_indices, other.point_indices)
    assert np.array_equal(before.colors, after.colors)


def test_of_many_points_some_find_the_cameras_and_all_are_placed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bent(tmp_path)
    old, new = tmp_path / "sparse" / "0", tmp_path / "sparse" / "refined"
    monkeypatch.setattr(adjustment, "ENOUGH", 160)
    before = pycolmap.Reconstruction(str(old))
    some = adjustment.thinned(pycolmap, before)
    assert some.num_points3D() < before.num_points3D()
    for key, image in some.images.items():
        assert image.num_points3D >= min(160, before.images[key].num_points3D)
    assert refine_cameras(old, new).better
    refined = pycolmap.Reconstruction(str(new))
    assert sorted(refined.point3D_ids()) == sorted(before.point3D_ids())
    assert refined.compute_num_observations() == before.compute_num_observations()
    assert np.median(np.linalg.norm(positions(refined) - POINTS, axis=1)) < 0.02


def test_names_with_spaces_in_a_text_model_stay_whole(tmp_path: Path) -> None:
    bent(tmp_path)
    scene = pycolmap.Reconstruction(str(tmp_path / "sparse" / "0"))
    for image in scene.images.values():
        image.name = f"a walk/{image.name}"
    model = tmp_path / "text"
    model.mkdir()
    scene.write_text(str(model))
    refine_cameras(model, tmp_path / "new")
    refined = pycolmap.Reconstruction(str(tmp_path / "new"))
    assert {i.name for i in refined.images.values()} == {f"a walk/{name}" for name in NAMES}


def test_cameras_that_fit_are_left_alone(tmp_path: Path) -> None:
    """Nothing but noise is left: more parameters cannot help."""
    write_project(
        tmp_path,
        names=NAMES,
        cameras=[camera("OPENCV", 240, 180, LENS)],
        points=POINTS,
        images=None,
        arc=2.0,
    )
    before = (tmp_path / "sparse" / "0" / "images.bin").read_bytes()
    done = refine_cameras(tmp_path / "sparse" / "0", tmp_path / "new")
    assert done.cameras == 0
    assert done.better == (tmp_path / "new").exists()
    assert (tmp_path / "sparse" / "0" / "images.bin").read_bytes() == before


def test_a_camera_of_few_photos_keeps_its_model(tmp_path: Path) -> None:
    bent(tmp_path, cameras=5)  # two photos each
    done = refine_cameras(tmp_path / "sparse" / "0", tmp_path / "new")
    assert done.cameras == 0


def test_a_photo_with_few_observations_stays_where_it_is(tmp_path: Path) -> None:
    bent(tmp_path)
    model = tmp_path / "sparse" / "0"
    scene = pycolmap.Reconstruction(str(model))
    image = next(i for i in scene.images.values() if i.name == NAMES[3])
    seen = [k for k, keypoint in enumerate(image.points2D) if keypoint.has_point3D()]
    for keypoint in seen[4:]:
        scene.delete_observation(image.image_id, keypoint)
    for keypoint in seen[:4]:  # what is left is wrong, and would send it far away
        image.points2D[keypoint].xy = np.random.default_rng(keypoint).uniform(0, 180, 2)
    scene.write(str(model))
    before = centres(model)
    assert refine_cameras(model, tmp_path / "new").better
    assert np.linalg.norm(centres(tmp_path / "new") - before, axis=1)[3] < 0.05


def test_wrong_matches_do_not_move_the_cameras(tmp_path: Path) -> None:
    made = bent(tmp_path)
    model = tmp_path / "sparse" / "0"
    scene = pycolmap.Reconstruction(str(model))
    rng = np.random.default_rng(9)
    for image in scene.images.values():
        for keypoint in rng.choice(len(image.points2D), 20, replace=False):
            image.points2D[keypoint].xy = rng.uniform(0, 180, 2)
    scene.write(str(model))
    done = refine_cameras(model, tmp_path / "new")
    assert done.better and done.after < 0.15
    truth = np.array([-pose[:3, :3].T @ pose[:3, 3] for pose in made.poses])
    assert np.linalg.norm(centres(tmp_path / "new") - truth, axis=1).max() < 0.1


@pytest.mark.parametrize("photos", [2, 3])
def test_too_few_tracks_are_one_clear_error(tmp_path: Path, photos: int) -> None:
    write_project(tmp_path, names=NAMES[:photos], images=None)
    with pytest.raises(SceneError, match="too few points observed by 4 or more photos"):
        refine_cameras(tmp_path / "sparse" / "0", tmp_path / "new")


def test_a_model_without_tracks_is_one_clear_error(tmp_path: Path) -> None:
    write_project(tmp_path, names=NAMES, images=None, tracks=False)
    with pytest.raises(SceneError, match="too few points"):
        refine_cameras(tmp_path / "sparse" / "0", tmp_path / "new")


def test_what_exists_is_not_replaced(tmp_path: Path) -> None:
    bent(tmp_path)
    model = tmp_path / "sparse" / "0"
    before = (model / "images.bin").read_bytes()
    with pytest.raises(SceneError, match="exists already"):
        refine_cameras(model, model)
    assert (model / "images.bin").read_bytes() == before
    (tmp_path / "file").write_text("mine")
    with pytest.raises(SceneError, match="exists already"):
        refine_cameras(model, tmp_path / "file")


def test_a_damaged_model_is_an_error(tmp_path: Path) -> None:
    bent(tmp_path)
    images = tmp_path / "sparse" / "0" / "images.bin"
    images.write_bytes(images.read_bytes()[:-100])
    with pytest.raises(SceneError, match="ends after"):
        refine_cameras(tmp_path / "sparse" / "0", tmp_path / "new")


def test_what_pycolmap_refuses_is_an_error(tmp_path: Path) -> None:
    """An observation of a point that the model does not have."""
    bent(tmp_path)
    scene = pycolmap.Reconstruction(str(tmp_path / "sparse" / "0"))
    model = tmp_path / "text"
    model.mkdir()
    scene.write_text(str(model))
    points = (model / "points3D.txt").read_text().splitlines()
    (model / "points3D.txt").write_text("\n".join(points[:-1]) + "\n")
    with pytest.raises(SceneError, match="pycolmap cannot use"):
        refine_cameras(model, tmp_path / "new")


def test_a_point_without_a_position_is_left_out(tmp_path: Path) -> None:
    bent(tmp_path)
    model = tmp_path / "sparse" / "0"
    scene = pycolmap.Reconstruction(str(model))
    lost = next(iter(scene.point3D_ids()))
    scene.points3D[lost].xyz = np.full(3, np.nan)
    scene.write(str(model))
    assert refine_cameras(model, tmp_path / "new").better
    refined = pycolmap.Reconstruction(str(tmp_path / "new"))
    assert refined.num_points3D() == scene.num_points3D() - 1


def test_an_output_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    bent(tmp_path)
    (tmp_path / "file").write_text("mine")
    with pytest.raises(SceneError, match="Cannot write"):
        refine_cameras(tmp_path / "sparse" / "0", tmp_path / "file" / "new")


def test_it_can_be_stopped(tmp_path: Path) -> None:
    bent(tmp_path)
    with pytest.raises(Stopped):
        refine_cameras(
            tmp_path / "sparse" / "0", tmp_path / "new", Context(should_stop=lambda: True)
        )
    assert not (tmp_path / "new").exists()


def test_the_command_writes_beside_the_model(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bent(tmp_path)
    assert main(["refine-cameras", str(tmp_path)]) == 0
    output = capsys.readouterr()
    assert "The cameras fit better" in output.out
    assert "bundle_adjustment" not in output.err
    assert load_colmap(tmp_path / "sparse" / "refined", pixels=False).images
    assert main(["refine-cameras", str(tmp_path)]) == 2
    assert refined_folder(Path("p/sparse/0")) == Path("p/sparse/refined")
    assert refined_folder(Path("p/sparse/1")) == Path("p/sparse/refined-1")
    assert refined_folder(Path("p/sparse")) == Path("p/sparse/refined")
    assert refined_folder(Path("p")) == Path("p/refined")
    assert "exists already" in capsys.readouterr().err
