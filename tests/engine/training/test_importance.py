"""Unimportant Gaussians go when densification ends, as many as the photos do not miss."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from roigs_engine.context import Context
from roigs_engine.cuda.device import CPU
from roigs_engine.errors import ConfigError, Stopped
from roigs_engine.formats.events import Event, Message
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import PosedImage, SfmScene
from roigs_engine.photos.cache import PhotoCache
from roigs_engine.photos.exposures import white
from roigs_engine.rasterize.view import rasterize_view
from roigs_engine.training import photo_order
from roigs_engine.training.config import TrainConfig
from roigs_engine.training.mechanisms import importance_pruning
from roigs_engine.training.mechanisms.density_control import DensityControl
from roigs_engine.training.mechanisms.importance_pruning import (
    EACH,
    WHOLE,
    Errors,
    ImportancePruning,
    PhotoErrors,
    is_within,
    least_important,
    visible_worth,
)
from roigs_engine.training.stage_data import PhotoViews, StageData
from roigs_engine.training.trainer import Trainer
from tests.engine.synthetic_scene import BOX, make_scene

DENSITY = DensityControl(start=10, until=40, every=10, grad_threshold=1e-5)
PLAIN = TrainConfig(steps=60, made_for="viewers", mechanisms=(DENSITY,))
CONFIG = PLAIN.using(ImportancePruning(growth=0.1))


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"))


def stage_data(scene: SfmScene) -> StageData:
    rows = range(len(scene.images))
    return StageData(
        images=scene.images,
        photos=PhotoCache(scene.images),
        photo_at=photo_order.shuffled(rows, 3),
        extent=scene.extent(),
    )


def model_of(scene: SfmScene) -> Gaussians:
    return Gaussians.from_points(scene.points, scene.colors)


def with_idle(scene: SfmScene, count: int = 50) -> Gaussians:
    """The model of the points, then Gaussians in it that are nearly transparent."""
    model = model_of(scene)
    idle = model.rows(torch.arange(count))
    idle.logit_opacities[:] = -5.0
    return Gaussians.concatenate([model, idle])


def same_bits(a: Gaussians, b: Gaussians) -> bool:
    return all(torch.equal(x, b.tensors()[name]) for name, x in a.tensors().items())


def photo(*errors: float, part: int = 0) -> list[tuple[int, float]]:
    """The errors of a part, photo by photo."""
    return [(part, error) for error in errors]


def squares(dropped: Tensor) -> list[tuple[int, float]]:
    """An error that grows by the dropped worth, from 100."""
    return photo(100.0 + float(dropped))


def by_part(errors: Errors) -> list[list[float]]:
    """The errors of each part that has some."""
    parts: dict[int, list[float]] = {}
    for part, error in errors:
        parts.setdefault(part, []).append(error)
    return [parts[part] for part in sorted(parts)]


@pytest.mark.parametrize("growth", [0.01, 0.1, 0.5])
def test_as_many_go_as_the_error_allows(growth: float) -> None:
    worth = torch.rand(2000, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    found = least_important(worth, lambda kept: squares(worth[~kept].sum()), growth)
    assert float(worth[~found].min()) >= float(worth[found].max())
    gone = float(worth[found].sum())
    assert gone <= 100.0 * growth
    three_percent = worth.sort().values[: int(found.sum()) + 60].sum()
    assert float(three_percent) > 100.0 * growth


def test_each_error_counts() -> None:
    worth = torch.arange(1, 101, dtype=torch.float64)

    def errors(kept: Tensor) -> Errors:
        return photo(1.0) + photo(1.0 if bool(kept[:20].all()) else 2.0, part=1)

    assert not least_important(worth, errors, 0.1).any()


def test_a_photo_that_gains_does_not_pay_for_others() -> None:
    """As one does that fog covers, which goes with the faint."""
    worth = torch.rand(2000, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    usual = least_important(worth, lambda kept: photo(100 + float(worth[~kept].sum())), 0.1)

    def fogged(kept: Tensor) -> Errors:
        lost = float(worth[~kept].sum())
        return photo(100 + 2 * lost, 5000 if bool(kept.all()) else 50)

    assert torch.equal(least_important(worth, fogged, 0.1), usual)


@pytest.mark.parametrize(
    ("after", "within", "asked"),
    [
        ([(0, 1.0), (1, 1.0), (0, 1.0), (1, 1.2)], True, 4),
        ([(0, 1.2), (1, 1.0), (0, 0.1), (1, 1.0)], True, 4),  # what one gains, no other may lose
        ([(0, 1.3), (1, 1.0), (0, 0.1), (1, 1.0)], False, 1),  # whatever the rest are
        ([(0, 1.15), (1, 1.0), (0, 1.15), (1, 1.0)], False, 3),
        ([(0, 1.0), (1, math.nan), (0, 1.0), (1, 1.0)], False, 2),
    ],
)
def test_no_more_photos_are_drawn_than_it_takes(
    after: list[tuple[int, float]], within: bool, asked: int
) -> None:
    before, drawn = [(0, 1.0), (1, 1.0), (0, 1.0), (1, 1.0)], []

    def drawing() -> Iterator[tuple[int, float]]:
        for error in after:
            drawn.append(error)
            yield error

    assert is_within(before, drawing(), 0.125) is within
    assert len(drawn) == asked


def test_what_no_photo_shows_stays() -> None:
    worth = torch.tensor([0.0, 0.0, 1.0, 2.0, 3.0, 0.0], dtype=torch.float64)
    found = least_important(worth, lambda kept: photo(1.0), 0.1)
    assert found.tolist() == [False, False, True, True, False, False]


def test_worth_is_low_for_what_is_faint_or_hidden(scene: SfmScene) -> None:
    model = with_idle(scene)
    outside = model.rows(torch.arange(1))
    outside.means[:] = 1e4
    worth = visible_worth(Gaussians.concatenate([model, outside]), scene.images)
    solid, idle = worth[:-51], worth[-51:-1]
    assert worth[-1] == 0
    assert 0 < idle.median() < 0.01 * solid.median()


def errors_of(data: StageData, rois: Sequence[OrientedBox] = ()) -> PhotoErrors:
    return PhotoErrors(PhotoViews(data, CPU, None), rois, None)


def test_errors_are_those_of_the_photos(scene: SfmScene) -> None:
    """On all pixels of some photos, and on each box's in some photos that see it."""
    some = replace(scene, images=scene.images[: min(WHOLE, EACH)])
    data, model = stage_data(some), model_of(scene)
    small = OrientedBox.between("small", [-0.1, -0.1, -0.1], [0.1, 0.1, 0.1])
    behind = OrientedBox.between("behind", [1e4, 0, 0], [1e4 + 1, 1, 1])
    squares: list[list[float]] = [[], [], []]
    for index, image in enumerate(some.images):
        drawn = rasterize_view(model, image.camera, image.world_to_camera).image[0]
        difference = (drawn - torch.from_numpy(data.photos[index]) / 255).square().mean(dim=-1)
        squares[0].append(float(difference.mean()))
        for place, box in ((1, BOX), (2, small)):
            pixels = box.silhouette(image.camera, image.world_to_camera)
            if pixels.any():
                squares[place].append(float(difference[torch.from_numpy(pixels)].mean()))
    found = by_part(errors_of(data, [BOX, behind, small])(model))
    assert found == [pytest.approx(p, rel=1e-4) for p in squares]
    assert by_part(errors_of(data)(model)) == found[:1]


def test_a_box_that_few_photos_show_is_judged(scene: SfmScene) -> None:
    """Its photos need not be among those that stand for the whole."""
    images = list(scene.images[:1]) * 60
    images[31] = scene.images[3]  # looks from the side
    pose = images[0].world_to_camera
    beside = np.linalg.inv(pose) @ [40.0, 0.0, 10.0, 1.0]  # out of the first photo's sight
    there = np.linalg.inv(images[31].world_to_camera) @ [0.0, 0.0, 0.3, 1.0]
    for place, errors in ((beside, 1), (there, 2)):
        box = OrientedBox.between("box", place[:3] - 0.02, place[:3] + 0.02)
        seen = [box.projected_area(i.camera, i.world_to_camera) > 0 for i in images]
        assert sum(seen) == errors - 1
        data = replace(stage_data(scene), images=images, photos=PhotoCache(images))
        assert len(by_part(errors_of(data, [box])(model_of(scene)))) == errors


def test_pixels_that_photos_leave_out_are_left_out(scene: SfmScene) -> None:
    image = scene.images[0]
    width, height = image.camera.width, image.camera.height
    pixels = np.random.default_rng(0).integers(0, 255, (height, width, 4), dtype=np.uint8)
    pixels[..., 3] = 0
    pixels[:5, :, 3] = 255

    class Photos:
        def __getitem__(self, index: int) -> np.ndarray:
            return pixels

    data = replace(stage_data(scene), images=[image], photos=Photos())
    model = model_of(scene)
    drawn = rasterize_view(model, image.camera, image.world_to_camera).image[0]
    expected = (drawn[:5] - torch.from_numpy(pixels[:5, :, :3]) / 255).square().mean()
    (found,) = by_part(errors_of(data)(model))
    assert found == pytest.approx([float(expected)], rel=1e-4)
    pixels[..., 3] = 0
    assert not list(errors_of(data)(model))


def test_without_anything_to_judge_by_all_stay() -> None:
    worth = torch.arange(1, 101, dtype=torch.float64)
    assert not least_important(worth, lambda kept: [], 0.1).any()


def test_nothing_is_pruned_where_nothing_was_added(scene: SfmScene) -> None:
    """A few steps: the photos can judge nothing yet."""
    for begin, until, every in ((40, 40, 10), (50, 40, 10), (0, 0, 10), (10, 60, 10), (0, 40, 40)):
        density = DensityControl(start=begin, until=until, every=every, grad_threshold=1e9)
        config = CONFIG.using(replace(density, prune_opacity=0.0, reset_every=0))
        trainer = Trainer(with_idle(scene), stage_data(scene), config)
        assert trainer.run()
        assert len(trainer.gaussians) == len(with_idle(scene))


def test_a_full_memory_while_it_looks_has_changed_nothing(
    scene: SfmScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*args: object) -> Tensor:
        raise MemoryError

    monkeypatch.setattr(importance_pruning, "visible_worth", full)
    trainer = Trainer(model_of(scene), stage_data(scene), CONFIG)
    with pytest.raises(MemoryError):
        trainer.run()
    assert trainer.step == DENSITY.until and trainer.is_between_steps


class Sizes:
    """Notes the number of Gaussians after each step, in place of a callback."""

    def __init__(self, trainer: Trainer) -> None:
        self.trainer, self.after = trainer, {}

    def call_if_due(self, seconds: float) -> float:
        self.after[self.trainer.step] = len(self.trainer.gaussians)
        return 0.0


def test_a_stage_prunes_once_when_densification_ends(scene: SfmScene) -> None:
    ends = DENSITY.until
    left = {}
    for growth in (0.0, 0.1):
        config = CONFIG if growth else PLAIN
        trainer = Trainer(with_idle(scene), stage_data(scene), config)
        said: list[Event] = []
        sizes = Sizes(trainer)
        trainer.run(Context(emit=said.append), callbacks=[sizes])
        texts = [event.text for event in said if isinstance(event, Message)]
        assert bool(texts) == bool(growth)
        assert len({size for step, size in sizes.after.items() if step > ends}) == 1
        left[growth] = sizes.after
    assert left[0.0][ends] == left[0.1][ends]
    assert left[0.1][ends + 1] < 0.95 * left[0.0][ends + 1]
    whole, removed = left[0.1][ends], left[0.1][ends] - left[0.1][ends + 1]
    assert texts == [
        "Looking for Gaussians with hardly any effect on the photos.",
        f"Removed {removed:,} Gaussians with hardly any effect on the photos, of {whole:,}.",
    ]


def test_stopped_meanwhile_it_goes_on_to_the_same_end(scene: SfmScene) -> None:
    model, data = with_idle(scene), stage_data(scene)
    whole = Trainer(model, data, CONFIG)
    whole.run()
    for asked in (DENSITY.until + 1, DENSITY.until + 5, DENSITY.until + 40):
        left = iter(range(asked))
        stopped = Trainer(model, data, CONFIG)
        assert not stopped.run(Context(should_stop=lambda left=left: next(left, None) is None))
        state = stopped.state_dict()
        resumed = Trainer(Gaussians(**state["parameters"]), data, CONFIG)
        resumed.load_state_dict(state)
        assert resumed.run()
        assert same_bits(resumed.gaussians, whole.gaussians), asked


def test_looking_for_them_can_be_stopped(scene: SfmScene) -> None:
    with pytest.raises(Stopped):
        visible_worth(model_of(scene), scene.images, Context(should_stop=lambda: True))


def test_a_negative_growth_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"growth is -0\.1"):
        CONFIG.using(ImportancePruning(growth=-0.1))


def test_what_a_levelled_photo_clips_is_no_error(scene: SfmScene) -> None:
    """A brighter photo is darkened; where it is white, the model may be brighter."""
    data, model = stage_data(scene), model_of(scene)
    model.sh[:, 0] = 1.7  # white
    grey = torch.full((48, 64, 3), white(2.0), dtype=torch.uint8).numpy()
    brighter = tuple(replace(image, exposure=2.0) for image in scene.images)

    def error(images: tuple[PosedImage, ...]) -> float:
        whitish = replace(data, images=images, photos=[grey] * len(images))
        return sum(value for _, value in errors_of(whitish, [BOX])(model))

    assert error(brighter) < 0.9 * error(scene.images)
