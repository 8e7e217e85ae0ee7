"""Choosing a GPU, and its check."""

from __future__ import annotations

import builtins
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from roigs_engine.cli import main
from roigs_engine.context import Context
from roigs_engine.cuda.device import CPU, choose_device
from roigs_engine.errors import KernelError
from roigs_engine.formats.events import Device
from roigs_engine.gpu import adapters
from roigs_engine.gpu.adapters import Adapter
from roigs_engine.gpu.program import FOLDER, close_gpu, drawing, opened
from roigs_engine.training import gpu_check
from tests.engine.gpu.software import software_adapter


@pytest.fixture(autouse=True)
def _own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A cache of its own, a small check, no card of NVIDIA's."""
    monkeypatch.setattr(gpu_check, "user_cache", lambda: tmp_path)
    monkeypatch.setattr(gpu_check, "COUNT", 100)
    monkeypatch.setattr(gpu_check, "COUNT_TIMED", 100)
    monkeypatch.setattr(gpu_check, "SIZE_TIMED", (40, 30))
    monkeypatch.setattr(torch.version, "cuda", None)
    yield
    close_gpu()


def made_up(**given: Any) -> Adapter:
    limits = {
        "max-storage-buffers-per-shader-stage": 31,
        "max-storage-buffer-binding-size": 1 << 31,
        "max-buffer-size": 1 << 28,
    }
    handle = type("Handle", (), {"limits": limits})
    kinds = {"is_software": False, "is_integrated": False}
    words = {"name": "Radeon", "api": "Vulkan", "driver": "RADV"}
    return Adapter(**{"handle": handle, **kinds, **words, **given})


def test_a_processor_that_plays_a_gpu_must_be_named(monkeypatch: pytest.MonkeyPatch) -> None:
    software, real = made_up(name="llvmpipe", is_software=True), made_up(name="AMD Radeon RX")
    monkeypatch.setattr(adapters, "adapters", lambda: (software,))
    with pytest.raises(KernelError, match="wgpu finds no GPU"):
        adapters.find()
    assert adapters.find("LLVM") is software and not adapters.is_any()
    monkeypatch.setattr(adapters, "adapters", lambda: (real, software))
    assert adapters.find() is adapters.find("radeon") is real and adapters.is_any()
    with pytest.raises(KernelError, match="no GPU named 'arc'"):
        adapters.find("arc")


def test_a_gpu_with_few_buffers_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    few = made_up()
    few.handle.limits["max-storage-buffers-per-shader-stage"] = 8
    monkeypatch.setattr(adapters, "adapters", lambda: (few,))
    with pytest.raises(KernelError, match="Radeon, Vulkan takes 8 buffers per kernel; 10 are"):
        adapters.find()
    assert few.largest == 1 << 28 and few.gaussians == (1 << 28) // 192


def test_without_wgpu_it_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    load = builtins.__import__

    def without(name: str, *given: Any, **more: Any) -> Any:
        if name == "wgpu":
            raise ModuleNotFoundError("No module named 'wgpu'")
        return load(name, *given, **more)

    adapters.wgpu.cache_clear()
    adapters.adapters.cache_clear()
    monkeypatch.setattr(builtins, "__import__", without)
    said: list[Any] = []
    assert choose_device("auto", Context(emit=said.append)) == CPU
    why = "This torch is built without CUDA. "
    why += "Other GPUs need the Python package wgpu, which is missing"
    assert said == [Device(kind="cpu", name="", reason=why)]
    with pytest.raises(KernelError, match=r"pip install 'roigs\[gpu\]'"):
        choose_device("gpu")


def test_somebody_else_may_have_asked_for_gpus_before() -> None:
    software_adapter()  # wgpu has its instance
    adapters.wgpu.cache_clear()
    assert adapters.wgpu().gpu.enumerate_adapters_sync()


def test_it_is_checked_before_it_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    adapter, said = software_adapter(), list[Any]()
    context = Context(emit=said.append)
    assert choose_device(f"gpu:{adapter.name}", context, gpu_check.check_once) == CPU
    assert said[-1] == Device(kind="gpu", name=adapter.title, reason="checked")
    assert drawing("cpu") == "gpu"
    said.clear()
    choose_device(f"gpu:{adapter.name}", context, gpu_check.check_once)
    assert len(said) == 1  # no second check
    choose_device("cpu", context)
    assert opened() is None and drawing("cpu") == "cpu"


@pytest.mark.parametrize(("cpu", "kind"), [(1e9, "gpu"), (1e-9, "cpu")])
def test_automatic_takes_it_if_it_is_faster(
    monkeypatch: pytest.MonkeyPatch, cpu: float, kind: str
) -> None:
    software = replace(software_adapter(), is_software=False)
    monkeypatch.setattr(adapters, "adapters", lambda: (software,))
    times, asked = {"gpu": 50.0, "cpu": cpu}, list[str]()

    def timed(device: torch.device, backend: str, **_: Any) -> float:
        asked.append(backend)
        return times[backend]

    monkeypatch.setattr(gpu_check, "step_milliseconds", timed)
    for _ in range(2):
        said = list[Any]()
        choose_device("auto", Context(emit=said.append), gpu_check.check_once)
        assert said[-1].kind == kind
        assert (kind == "gpu") == (opened() is not None)
    assert "takes 50 ms for a step, the CPU 0" in said[-1].reason or kind == "gpu"
    assert asked == ["gpu", "cpu"]  # once


def test_a_wrong_shader_is_caught_with_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_engine.gpu import program

    adapter = software_adapter()
    text = (FOLDER / "backward.wgsl").read_text(encoding="utf-8")
    assert "row.scale *= g.scale;" in text
    source = program.source

    def wrong(files: str) -> str:
        return source(files).replace("row.scale *= g.scale;", "row.scale *= 1.1 * g.scale;")

    monkeypatch.setattr(program, "source", wrong)
    monkeypatch.setattr(program, "_program", program.Program)
    with pytest.raises(KernelError, match=r"GPU check: differs .*gradient of log_scales by \d"):
        choose_device(f"gpu:{adapter.name}", check=gpu_check.check_once)
    assert opened() is None


def test_check_gpu_prints_errors_and_times(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    adapter = software_adapter()
    monkeypatch.setattr("roigs_engine.app.upkeep.GPU_STEPS", 1)
    assert main(["check-gpu", "--device", f"gpu:{adapter.name}"]) == 0
    said = capsys.readouterr().out
    assert f"GPU      {adapter.title}" in said and "ok     gradient of sh" in said
    assert "100 Gaussians, 40x30" in said and " ms" in said
