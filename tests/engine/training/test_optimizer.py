"""Adam on visible rows with a gradient: the dense Adam if all have one, nothing where none has."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pytest
import torch
from torch import Tensor

from roigs_engine.errors import EngineError
from roigs_engine.kernels import library
from tests.engine.training.adam_from_gradients import AdamFromGradients

SHAPES: dict[str, tuple[int, ...]] = {
    "means": (3,),
    "quats": (4,),
    "logit_opacities": (),
    "sh": (16, 3),
    "rest": (15, 3),
    "wide": (16,),
}
BACKENDS = ["cpu", "reference"]


@pytest.fixture(autouse=True)
def _threads() -> Iterator[None]:
    before = library.threads()
    yield
    library.set_threads(before)


def make(
    count: int, *, backend: str = "cpu", dtype: torch.dtype = torch.float32
) -> AdamFromGradients:
    generator = torch.Generator().manual_seed(0)
    parameters: dict[str, tuple[Tensor, float | Tensor]] = {}
    for number, (name, shape) in enumerate(SHAPES.items()):
        value = torch.randn(count, *shape, generator=generator).to(dtype)
        parameters[name] = (value, 1e-3 * (number + 1))
    rates = torch.full((16, 3), 1e-4)
    rates[0] = 2e-3
    parameters["sh"] = (parameters["sh"][0], rates.flatten())
    return AdamFromGradients(parameters, reference=backend == "reference")


def gradients(count: int, seed: int) -> dict[str, Tensor]:
    """Of very different sizes, as in training."""
    generator = torch.Generator().manual_seed(seed)
    sizes = 10.0 ** torch.randint(-6, 1, (count,), generator=generator)
    return {
        name: torch.randn(count, *shape, generator=generator) * sizes.view(-1, *[1] * len(shape))
        for name, shape in SHAPES.items()
    }


def give(optimizer: AdamFromGradients, given: dict[str, Tensor], visible: Tensor) -> None:
    for name, parameter in optimizer.parameters.items():
        assert parameter.grad is not None
        parameter.grad[visible] += given[name][visible].to(parameter.dtype)


def everything(optimizer: AdamFromGradients) -> dict[str, Tensor]:
    """All state by name, copied."""
    state: dict[str, Tensor] = {}
    for name, parameter in optimizer.parameters.items():
        assert parameter.grad is not None
        for kind, tensor in (
            ("value", parameter),
            ("gradient", parameter.grad),
            ("exp_avg", optimizer.exp_avg[name]),
            ("exp_avg_sq", optimizer.exp_avg_sq[name]),
        ):
            state[f"{kind} {name}"] = tensor.detach().clone()
    return state


def assert_equal(one: dict[str, Tensor], other: dict[str, Tensor]) -> None:
    assert one.keys() == other.keys()
    for name, value in one.items():
        assert torch.equal(value, other[name]), name


@pytest.mark.parametrize("backend", BACKENDS)
def test_all_visible_is_torch_adam(backend: str) -> None:
    count = 53
    ours = make(count, backend=backend)
    values = {n: p.detach().double().clone() for n, p in ours.parameters.items()}
    dc, higher = values["sh"][:, :1].clone(), values["sh"][:, 1:].clone()
    groups = [
        {"params": [values["means"]], "lr": 1e-3},
        {"params": [values["quats"]], "lr": 2e-3},
        {"params": [values["logit_opacities"]], "lr": 3e-3},
        {"params": [dc], "lr": 2e-3},
        {"params": [higher], "lr": 1e-4},
        {"params": [values["rest"]], "lr": 5e-3},
        {"params": [values["wide"]], "lr": 6e-3},
    ]
    dense = torch.optim.Adam(groups, eps=1e-15)
    for step in range(12):
        given = gradients(count, seed=step)
        give(ours, given, torch.ones(count, dtype=torch.bool))
        assert ours.step(torch.ones(count, dtype=torch.bool)) == 0
        for name, value in values.items():
            value.grad = given[name].double()
        dc.grad, higher.grad = given["sh"][:, :1].double(), given["sh"][:, 1:].double()
        dense.step()
    values["sh"] = torch.cat([dc, higher], dim=1)
    start = make(count)
    for name, parameter in ours.parameters.items():
        moved = values[name] - start.parameters[name].detach()
        difference = parameter.detach() - values[name]
        rounding = 3e-7 * values[name].norm()  # float32 parameters, a dozen steps
        assert difference.norm() <= 2e-5 * moved.norm() + rounding, name


@pytest.mark.parametrize("count", [1, 15, 16, 17, 530])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.6, 1.0])
def test_kernel_is_the_reference(count: int, share: float) -> None:
    fast, plain = make(count), make(count, backend="reference", dtype=torch.float64)
    for step in range(3):
        generator = torch.Generator().manual_seed(100 + step)
        visible = torch.rand(count, generator=generator) < share
        given = gradients(count, seed=step)
        for optimizer in (fast, plain):
            give(optimizer, given, visible)
            optimizer.step(visible)
    wanted = everything(plain)
    for name, value in everything(fast).items():
        assert torch.allclose(value.double(), wanted[name], rtol=1e-4, atol=2e-6), name


@pytest.mark.parametrize("backend", BACKENDS)
def test_rows_out_of_view_stay_as_they_are(backend: str) -> None:
    count = 200
    optimizer = make(count, backend=backend)
    everybody = torch.ones(count, dtype=torch.bool)
    give(optimizer, gradients(count, seed=0), everybody)
    optimizer.step(everybody)

    visible = torch.arange(count) % 3 == 0
    give(optimizer, gradients(count, seed=1), everybody)  # the contract broken: left alone
    before = everything(optimizer)
    optimizer.step(visible)
    for name, value in everything(optimizer).items():
        assert torch.equal(value[~visible], before[name][~visible]), name
        if name.startswith("gradient"):
            assert not value[visible].any(), name
        else:
            assert not torch.equal(value[visible], before[name][visible]), name


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("longest", [1, 5, 40])
def test_rows_may_learn_faster(backend: str, longest: int) -> None:
    """A factor of 4 moves a row as four times the learning rates do; moments are not changed."""
    count = 120
    plain, fast, mixed = (make(count, backend=backend) for _ in range(3))
    for name, rates in fast._learning_rates.items():
        fast.set_lr(name, 4 * rates)
    quick = torch.arange(count) // longest % 2 == 0
    mixed.row_rates = torch.where(quick, 4.0, 1.0)
    for step in range(3):
        visible = torch.rand(count, generator=torch.Generator().manual_seed(step)) < 0.8
        for optimizer in (plain, fast, mixed):
            give(optimizer, gradients(count, seed=step), visible)
            optimizer.step(visible)
    slow_state, fast_state = everything(plain), everything(fast)
    for name, value in everything(mixed).items():
        assert torch.equal(value[quick], fast_state[name][quick]), name
        assert torch.equal(value[~quick], slow_state[name][~quick]), name


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    "rates",
    [torch.ones(19), torch.ones(20, 1), torch.ones(20, dtype=torch.float64), torch.ones(40)[::2]],
)
def test_factors_that_do_not_fit_are_refused(backend: str, rates: Tensor) -> None:
    optimizer = make(20, backend=backend)
    optimizer.row_rates = rates
    with pytest.raises(EngineError, match="row_rates"):
        optimizer.step(torch.ones(20, dtype=torch.bool))
    assert optimizer.step_count == 0


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_broken_gradients_are_skipped_and_counted(backend: str, value: float) -> None:
    count = 40
    optimizer = make(count, backend=backend)
    visible = torch.arange(count) % 4 != 1
    give(optimizer, gradients(count, seed=0), visible)
    broken = {"means": 7, "logit_opacities": 8, "sh": 39, "rest": 0}
    for name, row in broken.items():
        gradient = optimizer.parameters[name].grad
        assert gradient is not None
        gradient[row].view(-1)[-1] = value
    before = everything(optimizer)
    assert optimizer.step(visible) == 4
    assert optimizer.skipped_rows == 4
    for name, after in everything(optimizer).items():
        kind, parameter = name.split()
        row = broken.get(parameter)
        assert after.isfinite().all(), name
        if row is not None and kind != "gradient":
            assert torch.equal(after[row], before[name][row]), name


@pytest.mark.parametrize("threads", [2, 5])
def test_same_bits_at_any_thread_count(threads: int) -> None:
    states = []
    for number in (1, threads):
        library.set_threads(number)
        optimizer = make(2100)
        visible = torch.rand(2100, generator=torch.Generator().manual_seed(1)) < 0.5
        for step in range(2):
            give(optimizer, gradients(2100, seed=step), visible)
            optimizer.step(visible)
        states.append(everything(optimizer))
    assert_equal(*states)


@pytest.mark.parametrize("backend", BACKENDS)
def test_visible_rows_without_a_gradient_stay_as_they_are(backend: str) -> None:
    optimizer = make(40, backend=backend)
    visible = torch.ones(40, dtype=torch.bool)
    give(optimizer, gradients(40, seed=0), visible)
    optimizer.step(visible)  # moments that would move the rows
    before = everything(optimizer)
    reached = torch.arange(40) % 3 == 0
    gradient = optimizer.parameters["quats"].grad
    assert gradient is not None
    gradient[reached] = 1.0
    optimizer.step(visible)
    for name, tensor in everything(optimizer).items():
        assert torch.equal(tensor[~reached], before[name][~reached]), name
        if name.startswith("value"):
            assert (tensor[reached] != before[name][reached]).any(), name


def test_moments_do_not_become_subnormal() -> None:
    parameter = torch.zeros(32, 3)
    optimizer = AdamFromGradients({"means": (parameter, 1e-3)})
    assert parameter.grad is not None
    visible = torch.ones(32, dtype=torch.bool)
    parameter.grad.fill_(1e-8)
    for _ in range(800):
        optimizer.step(visible)
        parameter.grad[:, 0] = 1e-8  # rows without a gradient would keep their moments
    assert not optimizer.exp_avg["means"][:, 1:].any()


@pytest.mark.parametrize("backend", BACKENDS)
def test_replace_takes_moments_along(backend: str) -> None:
    count = 30
    optimizer = make(count, backend=backend)
    visible = torch.ones(count, dtype=torch.bool)
    give(optimizer, gradients(count, seed=0), visible)
    optimizer.step(visible)
    before = everything(optimizer)

    rows = torch.tensor([4, -1, 4, 29, 0, -1, 11])
    values = {n: p.detach()[rows.clamp(min=0)] for n, p in optimizer.parameters.items()}
    optimizer.replace(values, rows)
    after = everything(optimizer)
    for name, value in after.items():
        assert len(value) == len(rows)
        if name.startswith("exp"):
            assert torch.equal(value[rows >= 0], before[name][rows[rows >= 0]]), name
            assert not value[rows < 0].any(), name
        if name.startswith("gradient"):
            assert not value.any(), name
    assert all(optimizer.parameters[n] is v and v.requires_grad for n, v in values.items())
    assert optimizer.step_count == 1
    optimizer.step(torch.ones(len(rows), dtype=torch.bool))


def test_replace_from_and_to_nothing() -> None:
    optimizer = make(3)
    empty = torch.zeros(0, dtype=torch.long)
    optimizer.replace({n: p.detach()[:0] for n, p in optimizer.parameters.items()}, empty)
    assert optimizer.step(torch.zeros(0, dtype=torch.bool)) == 0
    fresh = torch.tensor([-1, -1])
    optimizer.replace({n: torch.ones(2, *s) for n, s in SHAPES.items()}, fresh)
    assert optimizer.step(torch.ones(2, dtype=torch.bool)) == 0


def test_zero_moments() -> None:
    optimizer = make(20)
    visible = torch.ones(20, dtype=torch.bool)
    give(optimizer, gradients(20, seed=0), visible)
    optimizer.step(visible)
    optimizer.zero_moments("means")
    assert optimizer.exp_avg["quats"].all()
    assert not optimizer.exp_avg["means"].any()
    assert not optimizer.exp_avg_sq["means"].any()


def test_steps_are_large_after_moments_were_zeroed() -> None:
    """With gradients of one size, a step is as long as the learning rate; then several times."""
    value = torch.zeros(1, 3)
    optimizer = AdamFromGradients({"means": (value, 1.0)})
    lengths = []
    for step in range(3000):
        if step == 1500:
            optimizer.zero_moments("means")
        before = value.detach().clone()
        optimizer.parameters["means"].grad = torch.ones(1, 3)
        optimizer.step(torch.ones(1, dtype=torch.bool))
        lengths.append(float((value.detach() - before).abs().max()))
    assert lengths[1499] == pytest.approx(1, rel=0.01)
    assert 4 < max(lengths[1500:1600]) < 7
    assert lengths[1500] > 2 and lengths[-1] < 1.3


def test_resumed_is_uninterrupted() -> None:
    count = 64
    visible = torch.arange(count) % 3 != 0
    whole = make(count)
    for step in range(4):
        give(whole, gradients(count, seed=step), visible)
        whole.step(visible)
        if step == 1:
            values = {n: p.detach().clone() for n, p in whole.parameters.items()}
            saved = {
                k: {n: t.clone() for n, t in v.items()} if isinstance(v, dict) else v
                for k, v in whole.state_dict().items()
            }
    resumed = AdamFromGradients({n: (v, 0.0) for n, v in values.items()})
    resumed.load_state_dict(saved)
    for step in (2, 3):
        give(resumed, gradients(count, seed=step), visible)
        resumed.step(visible)
    assert_equal(everything(resumed), everything(whole))


def test_errors() -> None:
    optimizer = make(8)
    with pytest.raises(EngineError, match="visible is"):
        optimizer.step(torch.ones(7, dtype=torch.bool))
    with pytest.raises(EngineError, match="visible is"):
        optimizer.step(torch.ones(8, dtype=torch.uint8))
    with pytest.raises(EngineError, match="learning rates"):
        optimizer.set_lr("means", torch.ones(2))
    with pytest.raises(EngineError, match="Expected"):
        optimizer.replace({"means": torch.zeros(8, 3)}, torch.arange(8))
    with pytest.raises(EngineError, match="contiguous leaf"):
        AdamFromGradients({"means": (torch.zeros(3, 8).T, 1.0)})
    with pytest.raises(EngineError, match="numbers of rows"):
        AdamFromGradients({"a": (torch.zeros(3), 1.0), "b": (torch.zeros(4), 1.0)})
