"""`check-gpu`, with the shim in place of a card."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from roigs_engine.cli import main
from roigs_engine.commands.console import Console
from roigs_engine.cuda import card, compiler, device, driver
from roigs_engine.gpu import adapters as gpu_adapters
from roigs_engine.training import gpu_check
from tests.engine.cuda.shim import ShimProgram, compiled


@pytest.fixture
def _card(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device, "check_cuda", lambda context: device.CPU)
    monkeypatch.setattr(driver, "build", lambda: "580.95.05")
    monkeypatch.setattr(compiler, "load", lambda: SimpleNamespace(version=(13, 0)))
    for name, value in (
        ("get_device_capability", (8, 9)),
        ("get_device_name", "Some Card"),
        ("get_device_properties", SimpleNamespace(total_memory=8 << 30)),
    ):
        monkeypatch.setattr(torch.cuda, name, lambda _, value=value: value)
    monkeypatch.setattr(gpu_check, "COUNT", 100)
    monkeypatch.setattr(gpu_check, "user_cache", lambda: tmp_path)
    monkeypatch.setattr(gpu_check, "SIZE", (32, 32))
    monkeypatch.setattr(gpu_check, "COUNT", 100)


@pytest.mark.usefixtures("_card")
@pytest.mark.slow  # steps of the size of a real training, by kernels for GPUs on a CPU
def test_it_prints_everything_for_a_bug_report(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    program = ShimProgram(compiled())
    monkeypatch.setattr(card, "program", lambda device: program)
    monkeypatch.setattr("roigs_engine.app.upkeep.GPU_STEPS", 1)
    assert main(["check-gpu"]) == 0
    said = capsys.readouterr().out
    for part in ("580.95.05", "Some Card", "8.9", "8.0 GiB", "NVRTC 13.0", "ok     image"):
        assert part in said, said
    assert "GPU " in said and "CPU " in said and "WRONG" not in said


@pytest.mark.usefixtures("_card")
def test_a_wrong_kernel_is_an_error_after_the_figures(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    edit = ("blend.cu", "blue += weight * s.blue;", "blue += weight * s.red;")
    program = ShimProgram(compiled(("-O1",), [edit]))
    monkeypatch.setattr(card, "program", lambda device: program)
    assert main(["check-gpu"]) == 2
    said = capsys.readouterr()
    assert "WRONG  image" in said.out and "ok     visible" in said.out
    assert "error: GPU check: differs from the CPU" in said.err


def test_without_a_card_it_says_why(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(torch.version, "cuda", None)
    assert main(["check-gpu"]) == 2
    said = capsys.readouterr()
    assert "torch" in said.out and "error: This torch is built without CUDA." in said.err


def test_brief_only_says_which_device_trains(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(torch.version, "cuda", None)
    monkeypatch.setattr(gpu_adapters, "adapters", lambda: ())
    assert main(["check-gpu", "--brief"]) == 0
    said = capsys.readouterr()
    assert (
        said.err == "Device: the processor (This torch is built without CUDA. wgpu finds no GPU).\n"
    )
    assert not said.out
    monkeypatch.setattr(Console, "_read_input", lambda _: None)  # pytest has closed it
    assert main(["check-gpu", "--brief", "--events"]) == 0
    first, last = map(json.loads, capsys.readouterr().out.splitlines())
    assert first["event"] == "device" and first["kind"] == "cpu" and last["event"] == "done"


@pytest.mark.usefixtures("_card")
def test_brief_checks_the_card(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    program = ShimProgram(compiled())
    monkeypatch.setattr(card, "program", lambda device: program)
    assert main(["check-gpu", "--brief"]) == 0
    assert "Device: Some Card (checked)." in capsys.readouterr().err
    monkeypatch.setattr(gpu_check, "LIMIT", 0.0)
    monkeypatch.setattr(gpu_check, "_records", dict)
    assert main(["check-gpu", "--brief"]) == 0
    assert "processor (GPU check: differs from the CPU" in capsys.readouterr().err
