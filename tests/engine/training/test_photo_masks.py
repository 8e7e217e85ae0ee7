"""Training on photos with masks: ignored pixels have no say, in any stage and any kernel."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from roigs_engine.errors import EngineError
from roigs_engine.model.mask_coverage import counted_pixels
from roigs_engine.model.scene import PhotoMask, PosedImage, SfmScene
from roigs_engine.photos.decode import load_photo
from roigs_engine.photos.mask_images import load_mask, write_mask
from roigs_engine.run.config import RunConfig
from roigs_engine.run.definition import define_run
from roigs_engine.run.manifest import manifest_difference
from roigs_engine.run.strategies import plan_run
from roigs_engine.training.loss_masks import counted_weights, split_mask
from roigs_engine.training.mechanisms.box_density_control import box_budgets
from tests.engine.runs import plys, tiny, train
from tests.engine.synthetic_scene import BOX, make_scene
from tests.engine.training.reference_loss import photo_loss

BACKENDS = ["cpu", "reference"]


def pictures(height: int = 23, width: int = 31) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """A render, a photo, and which pixels count: all but a hole and a border."""
    rng = torch.Generator().manual_seed(4)
    image = torch.rand(height, width, 3, generator=rng)
    photo = torch.randint(0, 256, (height, width, 3), generator=rng, dtype=torch.uint8)
    counted = torch.ones(height, width, dtype=torch.bool)
    counted[5:12, 8:19] = False
    counted[:, :3] = False
    return image, photo, counted


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("weighted", [False, True])
def test_ignored_pixels_have_no_loss_and_no_gradient(backend: str, weighted: bool) -> None:
    image, photo, counted = pictures()
    weights = torch.rand(counted.shape) if weighted else None
    results = []
    for seed in (1, 2):
        rng = torch.Generator().manual_seed(seed)
        x, t = image.clone(), photo.clone()
        x[~counted] = 9 * torch.rand(x[~counted].shape, generator=rng)
        t[~counted] = torch.randint(0, 256, t[~counted].shape, generator=rng, dtype=torch.uint8)
        x[6, 9] = torch.nan if seed == 2 else torch.inf  # not even these get out
        x.requires_grad_()
        loss = photo_loss(x, t, weights=weights, counted=counted, backend=backend).loss
        loss.backward()
        assert x.grad is not None and not x.grad[~counted].any()
        assert x.grad[counted].abs().min() > 0
        results.append((loss.detach(), x.grad))
    assert torch.equal(results[0][0], results[1][0])
    assert torch.equal(results[0][1], results[1][1])


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_gradient_is_that_of_finite_differences(backend: str) -> None:
    image, photo, counted = pictures(13, 17)
    exact = image.double().requires_grad_()
    counted[:, 10:] = False
    loss = photo_loss(exact, photo, counted=counted, backend="reference")
    (gradient,) = torch.autograd.grad(loss.loss, exact)
    step = 1e-6
    for y, x in ((0, 3), (4, 9), (7, 5), (5, 12), (12, 0)):  # inside, at a rim, ignored
        for channel in range(3):
            values = []
            for sign in (1, -1):
                moved = image.double()
                moved[y, x, channel] += sign * step
                values.append(photo_loss(moved, photo, counted=counted, backend="reference").loss)
            difference = (values[0] - values[1]) / (2 * step)
            assert gradient[y, x, channel].item() == pytest.approx(difference.item(), abs=1e-8)
    ours = image.clone().requires_grad_()
    output = photo_loss(ours, photo, counted=counted, backend=backend)
    (mine,) = torch.autograd.grad(output.loss, ours)
    assert output.loss.item() == pytest.approx(loss.loss.item(), abs=3e-6)
    assert (mine - gradient).norm() <= 1e-4 * gradient.norm()


@pytest.mark.parametrize("backend", BACKENDS)
def test_no_pixel_ignored_is_as_no_mask_and_all_ignored_is_no_loss(backend: str) -> None:
    image, photo, counted = pictures()
    plain = photo_loss(image, photo, backend=backend)
    every = photo_loss(image, photo, counted=torch.ones_like(counted), backend=backend)
    assert [v.item() for v in every] == pytest.approx([v.item() for v in plain], rel=1e-6)
    none = photo_loss(image, photo, counted=torch.zeros_like(counted), backend=backend)
    assert none.loss.item() == 0
    with pytest.raises(EngineError, match="counted is"):
        photo_loss(image, photo, counted=counted.float(), backend=backend)


def test_a_pixel_weighs_as_in_a_photo_without_a_mask() -> None:
    image, photo, counted = pictures()
    image.requires_grad_()
    (whole,) = torch.autograd.grad(photo_loss(image, photo, ssim_weight=0).loss, image)
    _, share = counted_weights(None, counted)
    part = photo_loss(image, photo, ssim_weight=0, counted=counted)
    (gradient,) = torch.autograd.grad(part.loss * share, image)
    assert torch.allclose(gradient[counted], whole[counted], rtol=1e-4)
    assert split_mask(photo) == (photo, None)


def with_masks(scene: SfmScene, folder: Path, mask: np.ndarray, digest: str = "m") -> SfmScene:
    """The scene with that mask for every photo."""

    def masked(image: PosedImage) -> PosedImage:
        path = folder / f"{digest}.png"
        small = np.where(mask, np.uint8(255), np.uint8(0))
        write_mask(path, mask)
        made = PhotoMask(
            digest=digest, path=path, remake=lambda: write_mask(path, mask), small=small
        )
        return replace(image, mask=made)

    return replace(scene, images=tuple(map(masked, scene.images)))


def left() -> np.ndarray:
    """Ignores the left 20 columns: a whole tile and a part of the next."""
    mask = np.ones((48, 64), bool)
    mask[:, :20] = False
    return mask


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"))


@pytest.mark.parametrize("strategy", ["joint", "independent"])
def test_a_run_is_the_same_whatever_ignored_pixels_show(
    tmp_path: Path, scene: SfmScene, strategy: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Scene-GS, box stages and baselines; the photos' other pixels are equal.

    None of them has torch import sympy, which takes half a second.
    """
    monkeypatch.setitem(sys.modules, "torch.fx.experimental.symbolic_shapes", None)
    results = []
    for name in ("one", "other"):
        photos = make_scene(tmp_path_folder(tmp_path, f"{name} photos"))
        for k, image in enumerate(photos.images):
            pixels = load_photo(image)
            noise = np.random.default_rng(k + len(name)).integers(0, 256, (48, 20, 3))
            pixels[:, :20] = noise.astype(np.uint8)
            Image.fromarray(pixels).save(image.path)
        folder = tmp_path / name
        masked = with_masks(photos, tmp_path_folder(tmp_path, f"{name} masks"), left())
        config = full_size(strategy)
        train(folder, masked, [BOX], config, ["full-scene", "full-object"])
        results.append(plys(folder))
    assert results[0].keys() == results[1].keys() and len(results[0]) > 5
    assert results[0] == results[1]
    train(tmp_path / "plain", scene, [BOX], full_size(strategy))
    assert plys(tmp_path / "plain")["result.ply"] != results[0]["result.ply"]


def full_size(strategy: str) -> RunConfig:
    """A smaller photo mixes pixels at the edge of what is ignored."""
    return tiny(strategy, scene_scale=1.0)


def tmp_path_folder(folder: Path, name: str) -> Path:
    made = folder / name
    made.mkdir()
    return made


def test_masks_are_in_the_fingerprints_and_the_manifest(tmp_path: Path, scene: SfmScene) -> None:
    runs = [
        define_run(tmp_path / "run", given, [BOX], tiny("joint"))
        for given in (
            scene,
            with_masks(scene, tmp_path, left()),
            with_masks(scene, tmp_path, ~left(), "n"),
        )
    ]
    prints = [{s.name: s.fingerprint for s in plan_run(run).stages} for run in runs]
    for name, fingerprint in prints[0].items():
        assert len({fingerprint, prints[1][name], prints[2][name]}) == 3
    assert "masks" not in runs[0].manifest()
    plain, masked, other = (run.manifest() for run in runs)
    assert manifest_difference(masked, masked) == ""
    changes = ((plain, masked, "are new"), (masked, other, "changed"), (other, plain, "are gone"))
    for before, now, how in changes:
        assert manifest_difference(before, now).startswith(f"12 masks {how}, the first is ")


def test_ignored_pixels_do_not_count_for_budgets(tmp_path: Path, scene: SfmScene) -> None:
    masked = with_masks(scene, tmp_path, left())
    plain, fewer = (box_budgets(s.images, [BOX], 100.0) for s in (scene, masked))
    assert plain is not None and fewer is not None and 0 < fewer[0] < plain[0]
    image = masked.images[0]
    mask = load_mask(image)
    wanted = (BOX.silhouette(image.camera, image.world_to_camera) & mask).sum()
    assert counted_pixels(BOX, image) == pytest.approx(wanted)
    small = image.scaled(0.5)
    assert counted_pixels(BOX, small) == pytest.approx(wanted / 4, rel=0.1)
