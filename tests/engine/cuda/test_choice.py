"""Choosing a device, and what is said of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from roigs_engine.cli import main
from roigs_engine.context import Context
from roigs_engine.cuda.device import CPU, choose_device
from roigs_engine.errors import KernelError
from roigs_engine.formats.events import Device
from roigs_engine.gpu import adapters as gpu_adapters
from roigs_engine.model.gaussians import Gaussians


def test_auto_takes_the_cpu_and_says_why_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.version, "cuda", None)
    monkeypatch.setattr(gpu_adapters, "adapters", lambda: ())
    said: list[Any] = []
    assert choose_device("auto", Context(emit=said.append)) == CPU
    reason = "This torch is built without CUDA. wgpu finds no GPU"
    assert said == [Device(kind="cpu", name="", reason=reason)]
    assert choose_device("cpu", Context(emit=said.append)) == CPU
    assert said[1:] == [Device(kind="cpu", name="", reason="chosen")]
    with pytest.raises(KernelError, match="Install torch for CUDA"):
        choose_device("cuda")


def test_a_torch_for_cuda_without_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.version, "cuda", "13.0")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(KernelError, match="finds no NVIDIA GPU"):
        choose_device("cuda")


def test_the_commands_take_a_device(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(torch.version, "cuda", None)
    path = {"cameras": [
        {"name": "a", "width": 16, "height": 8, "fx": 9.0, "fy": 9.0, "cx": 8.0, "cy": 4.0,
         "world_to_camera": np.eye(4).tolist()},
    ]}  # fmt: skip
    (tmp_path / "path.json").write_text(json.dumps(path), encoding="utf-8")
    Gaussians.from_points(np.array([[0.0, 0, 3]]), np.zeros((1, 3), np.uint8)).save_ply(
        tmp_path / "one.ply"
    )
    command = ["render", str(tmp_path / "one.ply"), "--path", str(tmp_path / "path.json")]
    command += ["--out", str(tmp_path / "out")]
    assert main([*command, "--device", "cpu"]) == 0
    assert main([*command, "--device", "cuda"]) == 2
    assert "error: This torch is built without CUDA." in capsys.readouterr().err
