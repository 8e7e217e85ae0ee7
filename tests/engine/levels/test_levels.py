"""Levels of detail: made, measured, kept, and taken up again."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from roigs_engine.context import Context
from roigs_engine.errors import RunFolderError, Stopped
from roigs_engine.formats.levels import FADE, read_ladders
from roigs_engine.levels import make
from roigs_engine.levels.make import (
    LONGEST,
    SHARE,
    Measured,
    contributions,
    farther,
    make_level,
    make_levels,
    measure,
    spaced,
    training_views,
)
from roigs_engine.levels.parts import Part, View, parts_of_run, rate_of, small_picture, views_at
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.local_frame import LocalFrame
from roigs_engine.model.scene import Camera, PosedImage
from roigs_engine.rasterize.view import render_view
from roigs_engine.training.trainer import Trainer
from tests.engine.levels.balls import cloud

LENS = Camera(width=96, height=72, fx=100.0, fy=100.0, cx=48.0, cy=36.0)


def around(count: int, distance: float = 2.5) -> list[PosedImage]:
    """Cameras in a circle that look at the middle."""
    images = []
    for k, angle in enumerate(np.linspace(0, 2 * np.pi, count, endpoint=False)):
        pose = np.eye(4)
        c, s = np.cos(angle), np.sin(angle)
        pose[:3, :3] = [[c, 0, -s], [0, 1, 0], [s, 0, c]]
        pose[2, 3] = distance
        images.append(
            PosedImage(
                name=f"{k}.png",
                path=Path(),
                camera=LENS,
                world_to_camera=pose,
                point_indices=np.zeros(0, np.int64),
            )
        )
    return images


@pytest.fixture(autouse=True)
def near(monkeypatch: pytest.MonkeyPatch) -> None:
    """Measure up to a short distance, and train on few views between photos: time."""
    monkeypatch.setattr("roigs_engine.levels.make.FARTHEST", 2.6)
    monkeypatch.setattr("roigs_engine.levels.make.MOST_BETWEEN", 12)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run folder with a box and what is around."""
    cloud(1200, 0, shift=-0.3).save_ply(tmp_path / "rois/vase.ply")
    cloud(600, 1, size=0.8, shift=0.5).save_ply(tmp_path / "background.ply")
    return tmp_path


@pytest.fixture
def part(run: Path) -> Part:
    return next(p for p in parts_of_run(run, around(16), LocalFrame.world()) if p.box == "vase")


def view_of(image: PosedImage) -> View:
    return image.camera, image.world_to_camera


def test_a_run_has_a_ladder_for_each_part(run: Path) -> None:
    ladders = make_levels(run, around(16), LocalFrame.world(), levels=3, steps=10)
    assert [ladder.box for ladder in ladders] == ["", "vase"]
    found = read_ladders(run)["vase"]
    whole = found.levels[0]
    assert (whole.ply, whole.gaussians, whole.farther) == ("rois/vase.ply", 1200, 0)
    for k, count in ((1, 600), (2, 300)):
        assert len(Gaussians.load_ply(run / f"levels/{k}/rois/vase.ply")) == count
        assert len(Gaussians.load_ply(run / f"levels/{k}/background.ply")) == count // 2
    begins = [level.farther for level in found.levels]
    assert all(b >= FADE * a for a, b in pairwise(begins[1:]))


def test_levels_in_any_unit_are_the_same(tmp_path: Path, run: Path) -> None:
    images, frame = around(16), LocalFrame.world()
    near = make_levels(run, images, frame, levels=2, steps=5)[1]
    tiny = LocalFrame(origin=np.array([500.0, 0, 0]), scale=16.0)
    other = tmp_path / "other"
    for name in ("rois/vase.ply", "background.ply"):
        Gaussians.load_ply(run / name).save_ply(other / name, tiny)
    far = make_levels(other, images, tiny, levels=2, steps=5)[1]
    assert far.rate == pytest.approx(16 * near.rate, rel=1e-3)
    np.testing.assert_allclose((far.probes - tiny.origin) * 16, near.probes, atol=1e-3)
    assert [level.gaussians for level in far.levels] == [level.gaussians for level in near.levels]


def test_what_is_there_is_kept_and_what_was_made_of_another_result_is_made_again(run: Path) -> None:
    def make() -> dict[str, bytes]:
        make_levels(run, around(16), LocalFrame.world(), levels=2, steps=8)
        return {str(p): p.read_bytes() for p in sorted((run / "levels").rglob("*.ply"))}

    first = make()
    times = {path: Path(path).stat().st_mtime_ns for path in first}
    assert make() == first
    assert {path: Path(path).stat().st_mtime_ns for path in first} == times
    cloud(1200, 7, shift=-0.3).save_ply(run / "rois/vase.ply")
    second = make()
    changed = [Path(path).name for path in first if second[path] != first[path]]
    assert changed == ["vase.ply"]


def test_a_stopped_command_goes_on_to_the_same_bytes(run: Path, tmp_path: Path) -> None:
    frame, images = LocalFrame.world(), around(16)
    calls = iter(range(20))

    def soon() -> bool:
        """Some time after the first level."""
        return any((run / "levels").rglob("*.ply")) and next(calls, None) is None

    context = Context(should_stop=soon)
    with pytest.raises(Stopped):
        make_levels(run, images, frame, levels=3, steps=10, context=context)
    assert not (run / "levels.json").exists()
    begun = sorted((run / "levels").rglob("*.ply"))
    assert begun
    make_levels(run, images, frame, levels=3, steps=10)
    now = {p.relative_to(run): p.read_bytes() for p in (run / "levels").rglob("*.ply")}
    other = tmp_path / "again"
    for name in ("rois/vase.ply", "background.ply"):
        (other / name).parent.mkdir(parents=True, exist_ok=True)
        (other / name).write_bytes((run / name).read_bytes())
    make_levels(other, images, frame, levels=3, steps=10)
    assert now == {p.relative_to(other): p.read_bytes() for p in (other / "levels").rglob("*.ply")}


def test_training_makes_a_level_nearer_to_the_whole_drawn_without_aliasing(part: Part) -> None:
    views = training_views(around(16))
    trained = make_level(part, part.gaussians, views.train, 2, steps=200)
    assert trained is not None and len(trained) == 300
    small = views_at(part, views.train, 2.5)
    kept = contributions(part.gaussians, small)[0].topk(300).indices
    pruned = part.gaussians.rows(kept)
    before, after = (measure(part, [m], views.held)[0][2].level for m in (pruned, trained))
    assert after > before + 2


def test_what_few_views_show_is_trained_for_longer(
    part: Part, monkeypatch: pytest.MonkeyPatch
) -> None:
    lengths = []

    class Counted(Trainer):
        def run(self, *given: object, **options: object) -> bool:
            lengths.append(self.config.steps)
            return False

    monkeypatch.setattr("roigs_engine.levels.make.Trainer", Counted)
    seen = [view_of(image) for image in around(16)]
    _, share = contributions(part.gaussians, views_at(part, seen, 1.6))
    narrow = [(replace(camera, width=41), pose) for camera, pose in seen]
    _, less = contributions(part.gaussians, narrow)
    assert 0 < less < share / 2 < 0.5
    for given in (share, less, 1e-9):
        monkeypatch.setattr(
            "roigs_engine.levels.make.contributions",
            lambda model, *_, given=given: (torch.ones(len(model)), given),
        )
        make_level(part, part.gaussians, seen, 1, steps=100)
    expected = [100 * max(1.0, SHARE / share), 100 * SHARE / less, 100 * LONGEST]
    assert lengths == [round(min(steps, 100 * LONGEST)) for steps in expected]


def test_before_black_and_white_a_level_learns_where_light_comes_through(part: Part) -> None:
    views = training_views(around(16))
    trained = make_level(part, part.gaussians, views.train, 1, steps=200)
    assert trained is not None
    small = views_at(part, views.train, 1.6)
    pruned = part.gaussians.rows(contributions(part.gaussians, small)[0].topk(len(trained)).indices)
    (view, *_) = views_at(part, views.held, 1.6)
    for grey in (0.0, 1.0):
        truth = small_picture(part.gaussians, view, 2, grey)
        behind = torch.full((3,), grey)
        before, after = (
            float((truth - render_view(model, *view, background=behind).image).square().mean())
            for model in (pruned, trained)
        )
        assert after < before / 2


def test_views_show_the_part_as_coarsely_as_asked(part: Part) -> None:
    near, far = around(4, 1.5), around(4, 6.0)
    views = [view_of(image) for image in (*near, *far)]
    for coarser in (1.6, 2.5):
        found = views_at(part, views, coarser)
        assert 4 <= len(found) <= 8
        for camera, pose in found:
            whole = Camera(  # not cropped: all probes count
                **{**camera.__dict__, "width": 10_000, "height": 10_000, "cx": 5e3, "cy": 5e3}
            )
            rate = rate_of(part.probes, (whole, pose))
            assert rate == pytest.approx(part.rate / coarser, rel=0.05)


def test_a_level_does_from_where_it_stays_as_good_as_the_whole() -> None:
    def at(coarser: float, whole: float, level: float) -> Measured:
        return Measured(coarser=coarser, whole=whole, level=level, between=0.0)

    records = [at(1, 30, 31), at(2, 30, 29), at(3, 28, 28.5), at(4, 25, 30)]
    found = farther(records)
    assert found is not None and found.coarser == 3
    assert farther([at(1, 30, 20)]) is None
    # An anti-aliased whole part is all but right from anywhere: nobody sees what a level lacks.
    found = farther([at(1, 48, 37), at(2, 47, 41), at(3, 47, 42)])
    assert found is not None and found.coarser == 2
    assert farther([]) is None
    assert spaced([1.0, 1.05, 3.0]) == pytest.approx([1.0, FADE**2, 3.0])


def test_few_photos_are_all_trained_on(part: Part) -> None:
    few, many = training_views(around(6)), training_views(around(32))
    assert len(few.train) > 6 and few.held
    assert len(many.held) == 4
    own = {image.world_to_camera.tobytes() for image in around(32)}
    held = {pose.tobytes() for _, pose in many.held}
    assert held <= own and not held & {pose.tobytes() for _, pose in many.train}
    (alone,) = around(1)
    assert training_views([alone]).held


def test_a_file_that_is_of_no_box_is_no_part(run: Path) -> None:
    cloud(600, 3).save_ply(run / "rois/vase copy.ply")
    (run / "manifest.json").write_text('{"rois": [{"name": "vase"}]}')
    parts = parts_of_run(run, around(4), LocalFrame.world())
    assert [part.box for part in parts] == ["", "vase"]


def test_a_run_that_lacks_a_box_has_no_levels(run: Path) -> None:
    (run / "manifest.json").write_text('{"rois": [{"name": "vase"}, {"name": "pot"}]}')
    with pytest.raises(RunFolderError, match=r"rois has no pot\.ply"):
        make_levels(run, around(4), LocalFrame.world(), levels=2, steps=1)


def test_a_part_that_no_photo_shows_is_drawn_whole(run: Path) -> None:
    cloud(600, 3, shift=1e5).save_ply(run / "rois/pin.ply")
    make_levels(run, around(16), LocalFrame.world(), levels=2, steps=3)
    assert [level.ply for level in read_ladders(run)["pin"].levels] == ["rois/pin.ply"]


@pytest.mark.parametrize("value", [float("nan"), 1e30])
def test_gaussians_without_a_place_are_no_probes(run: Path, value: float) -> None:
    broken = cloud(100, 3)
    for tensor in broken.tensors().values():
        tensor[:50] = value
    broken.save_ply(run / "rois/pin.ply")
    for tensor in broken.tensors().values():
        tensor[:] = value
    broken.save_ply(run / "rois/lost.ply")
    make_levels(run, around(16), LocalFrame.world(), levels=2, steps=3)
    assert set(read_ladders(run)) == {"", "pin", "vase"}


def test_a_small_part_has_fewer_levels(run: Path) -> None:
    cloud(150, 3).save_ply(run / "rois/pin.ply")
    ladders = {
        ladder.box: ladder
        for ladder in make_levels(run, around(16), LocalFrame.world(), levels=3, steps=3)
    }
    assert not (run / "levels/2/rois/pin.ply").exists()
    assert len(ladders["pin"].levels) <= 2


def test_a_level_of_a_killed_engine_is_not_taken_for_another(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some steps, then others until the engine is killed, then the first again."""
    images, frame, ply = around(20), LocalFrame.world(), "levels/1/rois/vase.ply"
    make_levels(run, images, frame, levels=2, steps=4)
    first = (run / ply).read_bytes()
    with monkeypatch.context() as killed:
        write = make.write_json

        def killed_by(path: Path, value: dict[str, str]) -> None:
            if ply in value:
                raise KeyboardInterrupt
            write(path, value)

        killed.setattr(make, "write_json", killed_by)
        killed.setattr(make, "parts_of_run", lambda *given: parts_of_run(*given)[::-1])
        with pytest.raises(KeyboardInterrupt):
            make_levels(run, images, frame, levels=2, steps=6)
    make_levels(run, images, frame, levels=2, steps=4)
    assert (run / ply).read_bytes() == first


@pytest.mark.parametrize("damage", [b"", b"ply", None], ids=["lost", "half", "other bytes"])
def test_a_damaged_level_is_made_again(run: Path, damage: bytes | None) -> None:
    images, frame, ply = around(20), LocalFrame.world(), run / "levels/1/rois/vase.ply"
    make_levels(run, images, frame, levels=2, steps=4)
    first = ply.read_bytes()
    ply.write_bytes(first[:-4] + bytes(4) if damage is None else damage)  # a PLY, but another
    make_levels(run, images, frame, levels=2, steps=4)
    assert ply.read_bytes() == first
