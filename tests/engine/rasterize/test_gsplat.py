"""The gsplat backend without a card: what is passed to gsplat, and what is made of its answers."""

from __future__ import annotations

import inspect
from typing import Any

import pytest
import torch
from torch import Tensor

from roigs_engine.cuda import library
from roigs_engine.errors import KernelError
from roigs_engine.rasterize import rasterize
from tests.engine import fake_gsplat
from tests.engine.rasterize_cases import (
    BACKGROUND,
    cameras,
    differentiate,
    gaussians,
    gradient_errors,
    relative_error,
)

SIZE = (61, 43)


@pytest.fixture(autouse=True)
def _gsplat(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(library, "gsplat", lambda: fake_gsplat)


def ring() -> Tensor:
    mask = torch.zeros(SIZE[1], SIZE[0], dtype=torch.bool)
    mask[2:40, 18:60] = True
    mask[17:30, 33:47] = False
    return mask


CASES: dict[str, dict[str, Any]] = {
    "plain": {},
    "background": {"background": BACKGROUND},
    "lower degree": {"sh_degree": 1},
    "rectangle": {"mask": (20, 20, 40, 30), "background": BACKGROUND},
    "mask": {"mask": ring(), "background": BACKGROUND, "with_depth": True},
    "depth": {"with_depth": True},
    "pixel size": {"pixel_size": 2.0},
    "anti-aliased": {"antialiased": True},
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("raw", [False, True])
def test_it_draws_what_the_reference_draws(name: str, raw: bool) -> None:
    scene = (gaussians(60, raw=raw), *cameras(*SIZE), *SIZE)
    options = {"raw": raw, **CASES[name]}
    truth, true_gradients = differentiate("reference", torch.float64, *scene, **options)
    ours, gradients = differentiate("gsplat", torch.float32, *scene, **options)
    # the last 1e-4 of the light is not drawn
    assert (ours.image - truth.image).abs().max() < 1e-4
    assert (ours.alpha - truth.alpha).abs().max() < 1e-4
    if ours.depth is not None and truth.depth is not None:
        assert (ours.depth - truth.depth).abs().max() < 2e-3
    assert max(gradient_errors(gradients, true_gradients).values()) < 1e-4
    assert relative_error(ours.grad2d, truth.grad2d) < 1e-4
    assert ours.visible[truth.visible].all()
    assert not ours.grad2d[~ours.visible].any()


def test_gaussians_that_are_not_finite_are_left_out_with_their_gradients() -> None:
    parameters = gaussians(40, raw=True)
    whole = rasterize(*parameters, *cameras(*SIZE), *SIZE, raw=True, backend="gsplat")
    seen = whole.visible.all(dim=0).nonzero()[:5, 0].tolist()
    broken = [p.clone() for p in parameters]
    values = [torch.nan, torch.inf, 60.0, torch.nan, torch.nan]  # exp(60) squared is infinite
    for tensor, row, value in zip(broken, seen, values, strict=True):
        tensor[row].fill_(value)
    rest = [i for i in range(40) if i not in seen]
    few = [p[rest] for p in parameters]
    ours, gradients = differentiate(
        "gsplat", torch.float32, broken, *cameras(*SIZE), *SIZE, raw=True
    )
    expected, right = differentiate("gsplat", torch.float32, few, *cameras(*SIZE), *SIZE, raw=True)
    assert torch.equal(ours.image, expected.image)
    assert not ours.visible[:, seen].any()
    for ours_, right_ in zip(gradients, right, strict=True):
        assert torch.allclose(ours_[rest], right_, atol=1e-6)
        assert not ours_[seen].any()


@pytest.mark.parametrize(("count", "region"), [(0, None), (9, (0, 0, 0, 0))])
def test_where_nothing_is_drawn_there_is_the_background(
    count: int, region: tuple[int, int, int, int] | None
) -> None:
    leaves = [p.requires_grad_() for p in gaussians(count)]
    output = rasterize(
        *leaves, *cameras(*SIZE), *SIZE, background=BACKGROUND, mask=region, backend="gsplat"
    )
    output.image.sum().backward()
    assert torch.equal(output.image, BACKGROUND.expand(2, *SIZE[::-1], 3))
    assert not output.visible.any() and not output.alpha.any()


def test_it_takes_float32_only() -> None:
    parameters = [p.double() for p in gaussians(3)]
    with pytest.raises(KernelError, match="float32"):
        rasterize(*parameters, *(c.double() for c in cameras(*SIZE)), *SIZE, backend="gsplat")


def test_weights_without_triton_say_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(library, "has_triton", lambda: False)
    with pytest.raises(KernelError, match="pip install triton"):
        rasterize(*gaussians(9), *cameras(*SIZE), *SIZE, with_max_weight=True, backend="gsplat")


def test_a_median_depth_is_refused() -> None:
    with pytest.raises(KernelError, match="no median depth"):
        rasterize(*gaussians(3), *cameras(*SIZE), *SIZE, with_depth="median", backend="gsplat")


def test_every_call_fits_the_documented_interface(monkeypatch: pytest.MonkeyPatch) -> None:
    """All arguments are passed by name, and these names are those of `library.CALLS`."""
    passed: dict[str, set[str]] = {}

    class Watched:
        def __getattr__(self, name: str) -> Any:
            def call(*positional: Any, **named: Any) -> Any:
                assert not positional
                passed.setdefault(name, set()).update(named)
                return getattr(fake_gsplat, name)(**named)

            return call

    monkeypatch.setattr(library, "gsplat", Watched)
    rasterize(*gaussians(9), *cameras(*SIZE), *SIZE, backend="gsplat")
    assert passed == {name: set(arguments) for name, arguments in library.CALLS.items()}
    library.check_interface(fake_gsplat)


def test_the_real_gsplat_has_the_interface() -> None:
    real = pytest.importorskip("gsplat")
    library.check_interface(real)
    for name in library.CALLS:
        theirs = inspect.signature(getattr(real, name)).parameters
        mine = inspect.signature(getattr(fake_gsplat, name)).parameters
        assert list(mine) == list(theirs), name
        for parameter in mine:
            assert mine[parameter].default == theirs[parameter].default, (name, parameter)


def test_another_gsplat_is_named_with_what_it_lacks() -> None:
    class Other:
        __version__ = "0.1"

    with pytest.raises(KernelError, match=r"gsplat 0\.1 has no fully_fused_projection.*1\.5\.3"):
        library.check_interface(Other)
