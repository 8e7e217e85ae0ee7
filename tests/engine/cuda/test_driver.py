"""The driver and what is loaded into it, with a made-up driver: every failure is one line."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import torch

from roigs_engine.context import Context
from roigs_engine.cuda import card, driver
from roigs_engine.cuda import compiler as compiling
from roigs_engine.cuda.bindings import Loss
from roigs_engine.cuda.device import CPU, choose_device
from roigs_engine.errors import KernelError

GPU = torch.device("cuda:0")


class FakeDriver:
    """Its library's functions: all succeed, but for those in `failing`."""

    def __init__(self, version: int = 13000, **failing: int) -> None:
        self._version, self._failing = version, failing
        self.called: list[str] = []

    def __getattr__(self, name: str) -> Any:
        def call(*arguments: Any) -> int:
            self.called.append(name)
            if name == "cuDriverGetVersion":
                arguments[0]._obj.value = self._version
            if name == "cuGetErrorString":
                arguments[1]._obj.value = b"some reason"
            return self._failing.get(name, 0)

        return call


class FakeCompiler:
    """Compiles to nothing; `compiled` are the compute capabilities that it was asked for."""

    version = (13, 0)

    def __init__(self) -> None:
        self.compiled: list[int] = []

    def architectures(self) -> list[int]:
        return [75, 80, 86, 89, 90, 100, 120]

    def compile(self, target: int) -> bytes:
        self.compiled.append(target)
        return b"code"


@pytest.fixture
def compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FakeCompiler:
    """A torch with a GPU, a compiler, and a cache of its own."""
    made = FakeCompiler()
    monkeypatch.setattr(compiling, "user_cache", lambda: tmp_path)
    monkeypatch.setattr(compiling, "load", lambda: made)
    monkeypatch.setattr(torch.version, "cuda", "13.0")
    for name, value in (
        ("is_available", True),
        ("current_device", 0),
        ("init", None),
        ("get_device_capability", (8, 9)),
        ("get_device_name", "Card"),
    ):
        monkeypatch.setattr(torch.cuda, name, lambda *_, value=value: value)
    card.program.cache_clear()
    return made


def use(monkeypatch: pytest.MonkeyPatch, fake: FakeDriver) -> None:
    monkeypatch.setattr(driver, "load", lambda: driver.Driver(fake))


def test_kernels_are_compiled_once_and_launched_on_torchs_stream(
    compiler: FakeCompiler, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake = FakeDriver()
    use(monkeypatch, fake)
    said: list[Any] = []
    for _ in range(2):
        card.program.cache_clear()
        card.prepare(GPU, Context(emit=said.append))
    assert compiler.compiled == [89]
    assert [event.text[:25] for event in said] == ["Compiling the GPU kernels"]
    assert fake.called.count("cuModuleGetFunction") == 2 * len(compiling.KERNELS)
    stream = type("Stream", (), {"cuda_stream": 7})
    monkeypatch.setattr(torch.cuda, "current_stream", lambda device: stream)
    card.program(GPU).launch("loss", 3, 256, Loss())
    assert fake.called[-1] == "cuLaunchKernel"


@pytest.mark.parametrize(
    ("fake", "line"),
    [
        (
            FakeDriver(12040),
            r"driver is for CUDA 12\.4; .*by CUDA 13\.0\. Update the NVIDIA driver",
        ),
        (FakeDriver(cuInit=100), r"cuInit failed \(100, some reason\)"),
        (FakeDriver(cuModuleLoadData=2), "GPU memory is full"),
        (FakeDriver(cuModuleLoadData=200), r"cuModuleLoadData failed \(200.*Update the NVIDIA"),
    ],
)
def test_failures_are_one_line_and_the_cpu_trains(
    fake: FakeDriver, line: str, compiler: FakeCompiler, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver, "load", lambda: driver.Driver(fake))
    with pytest.raises(KernelError, match=line) as caught:
        choose_device("cuda")
    assert "\n" not in str(caught.value)
    said: list[Any] = []
    assert choose_device("auto", Context(emit=said.append)) == CPU
    assert said[-1].kind == "cpu" and re.search(line.partition(".*")[0], said[-1].reason)


def test_code_that_the_card_refuses_is_compiled_again(
    compiler: FakeCompiler, monkeypatch: pytest.MonkeyPatch
) -> None:
    use(monkeypatch, FakeDriver(cuModuleLoadData=200))
    with pytest.raises(KernelError):
        card.program(GPU)
    use(monkeypatch, FakeDriver())
    card.program(GPU)
    assert compiler.compiled == [89, 89]


@pytest.mark.parametrize(("capability", "target"), [((8, 7), 86), ((9, 0), 90), ((12, 1), 120)])
def test_the_newest_code_that_runs_on_a_card(
    capability: tuple[int, int],
    target: int,
    compiler: FakeCompiler,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda device: capability)
    assert compiling.architecture(GPU, compiler) == target  # type: ignore[arg-type]


@pytest.mark.parametrize(("capability", "hint"), [((6, 1), "Use the CPU"), ((13, 0), "newer CUDA")])
def test_a_card_that_the_compiler_does_not_know(
    capability: tuple[int, int],
    hint: str,
    compiler: FakeCompiler,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda device: capability)
    with pytest.raises(KernelError, match=rf"compute capability \d+\.\d.*{hint}"):
        compiling.architecture(GPU, compiler)  # type: ignore[arg-type]


def test_without_a_driver(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driver, "LIBRARY", "no-such-driver.so")
    with pytest.raises(KernelError, match=r"no NVIDIA driver.*Install"):
        driver.load.__wrapped__()
