"""The check of a GPU, with the shim in place of one: what is wrong is caught, in one line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import torch

from roigs_engine.context import Context
from roigs_engine.cuda import card, driver
from roigs_engine.cuda.device import CPU, choose_device
from roigs_engine.errors import KernelError
from roigs_engine.kernels import library
from roigs_engine.training import gpu_check
from tests.engine.cuda.shim import ShimProgram, compiled


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A user's cache of its own."""
    monkeypatch.setattr(gpu_check, "user_cache", lambda: tmp_path)
    return tmp_path / "cuda" / "checked.json"


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpu_check, "COUNT", 200)


def test_right_kernels_pass_and_are_not_checked_again(shim: ShimProgram, cache: Path) -> None:
    said: list[Any] = []
    context = Context(emit=said.append)
    gpu_check.check_once(CPU, context)
    (errors,) = json.loads(cache.read_text()).values()
    assert {"image", "loss", "gradient of means", "step of sh"} < set(errors)
    assert max(errors.values()) < 1e-3, errors
    assert [event.text for event in said] == ["Checking the GPU against the CPU, once."]
    launched = len(shim.launched)
    gpu_check.check_once(CPU, context)
    assert len(shim.launched) == launched and len(said) == 1


def test_another_driver_is_checked_again(
    shim: ShimProgram, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = gpu_check.machine_key(CPU)
    monkeypatch.setattr(driver, "build", lambda: "999.1")
    assert gpu_check.machine_key(CPU) != before


@pytest.mark.parametrize(
    ("source", "old", "new", "what"),
    [
        ("blend.cu", "blue += weight * s.blue;", "blue += weight * s.red;", "image"),
        ("gradient.cu", "sum[kSUV] += gu * at.v;", "sum[kSUV] += gu * at.u;", "gradient of quats"),
        (
            "backward.cu",
            "correction2 + s.epsilon",
            "correction2 * 1.1f + s.epsilon",
            "step of means",
        ),
        ("loss.cu", "0.0360007721f", "0.0460007721f", "loss"),
    ],
)
def test_a_wrong_kernel_is_caught_with_numbers(
    source: str, old: str, new: str, what: str, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = ShimProgram(compiled(("-O1",), [(source, old, new)]))
    monkeypatch.setattr(card, "program", lambda device: program)
    with pytest.raises(KernelError, match=rf"GPU check: differs .*{what} by \d\.\de") as caught:
        gpu_check.check_once(CPU)
    assert "\n" not in str(caught.value) and json.loads(cache.read_text()) == {}


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (torch.OutOfMemoryError("CUDA out of memory. Tried 2 GiB"), "the GPU memory is full"),
        (RuntimeError("CUDA error: an illegal memory access\nmore"), "an illegal memory access"),
        (KernelError("NVIDIA driver: cuLaunchKernel failed (700, x).", "h"), "cuLaunchKernel"),
    ],
)
def test_a_failing_card_is_one_line_and_the_cpu_trains(
    error: Exception, line: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Failing:
        def launch(self, *_: Any) -> None:
            raise error

    monkeypatch.setattr(card, "program", lambda device: Failing())
    monkeypatch.setattr("roigs_engine.cuda.device.check_cuda", lambda context: CPU)
    said: list[Any] = []
    found = choose_device("auto", Context(emit=said.append), gpu_check.check_once)
    assert found == CPU
    assert line in said[-1].reason and said[-1].reason.startswith("GPU check: ")
    assert "\n" not in said[-1].reason and said[-1].kind == "cpu"
    with pytest.raises(KernelError, match=line):
        choose_device("cuda", check=gpu_check.check_once)


def test_a_check_that_never_ended_is_not_tried_again(
    shim: ShimProgram, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A driver may hang, or take the process with it; then the record says when it began."""
    seen: list[Any] = []
    monkeypatch.setattr(gpu_check, "check", lambda device: seen.append(cache.read_text()) or {})
    gpu_check.check_once(CPU)
    began = json.loads(seen[0])
    assert [type(value) for value in began.values()] == [float]
    cache.write_text(json.dumps({key: value - 1000 for key, value in began.items()}))
    with pytest.raises(KernelError, match=r"the last check did not finish.*check-gpu"):
        gpu_check.check_once(CPU)
    gpu_check.check_again(CPU)
    gpu_check.check_once(CPU)
    assert len(seen) == 2


def test_a_check_that_is_stopped_is_forgotten(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(device: torch.device) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(gpu_check, "check", stopped)
    with pytest.raises(KeyboardInterrupt):
        gpu_check.check_once(CPU)
    assert json.loads(cache.read_text()) == {}


def test_a_damaged_record_is_no_obstacle(shim: ShimProgram, cache: Path) -> None:
    cache.parent.mkdir()
    cache.write_text("[1")
    gpu_check.check_once(CPU)
    assert len(json.loads(cache.read_text())) == 1


def test_the_cache_is_the_kernels_own() -> None:
    assert library._user_cache_folder().is_relative_to(library.user_cache())
