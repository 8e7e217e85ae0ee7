"""NVRTC compiles every kernel for every kind of card; it needs none."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from roigs_engine.cuda import compiler
from roigs_engine.errors import KernelError

OLDEST = 75
NEWER = (80, 86, 89, 90, 100, 120)


@pytest.mark.parametrize(
    "architecture",
    [OLDEST, *(pytest.param(each, marks=pytest.mark.slow) for each in NEWER)],
)
def test_every_kernel_compiles(architecture: int) -> None:
    if not compiler.libraries():
        pytest.skip("NVRTC is not installed: pip install nvidia-cuda-nvrtc")
    code = compiler.load().compile(architecture)
    assert code.startswith(b"\x7fELF")
    for kernel in compiler.KERNELS:
        assert b".text." + kernel.encode() + b"\0" in code


def test_a_mistake_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    if not compiler.libraries():
        pytest.skip("NVRTC is not installed: pip install nvidia-cuda-nvrtc")
    monkeypatch.setattr(compiler, "source_text", lambda: "int wrong = nothing;")
    with pytest.raises(KernelError, match=r'roigs\.cu\(1\): error.*"nothing"') as caught:
        compiler.load().compile(89)
    assert "\n" not in str(caught.value)


def test_it_is_found_where_wheels_keep_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = (
        "nvidia/cuda_nvrtc/lib/libnvrtc.so.12",
        "nvidia/cuda_nvrtc/lib/libnvrtc-builtins.so.12.9",
        "nvidia/cuda_nvrtc/lib/libnvrtc.alt.so.12",
        "nvidia/cu13/lib/libnvrtc.so.13",
        "nvidia/cuda_nvrtc/bin/nvrtc64_120_0.dll",
        "nvidia/cu13/bin/x86_64/nvrtc64_130_0.dll",
        "nvidia/cu13/bin/x86_64/nvrtc64_130_0.alt.dll",
        "torch/lib/nvrtc64_130_0.dll",
        "torch/lib/nvrtc-builtins64_130.dll",
    )
    for name in names:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    found = {path.relative_to(tmp_path).as_posix() for path in compiler.libraries()}
    assert found == {n for n in names if "builtins" not in n and ".alt." not in n}


def test_without_it_the_line_says_where_it_comes_from(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiler, "libraries", list)
    with pytest.raises(KernelError, match=r"NVRTC is not installed.*torch for CUDA"):
        compiler.load.__wrapped__()


def test_one_that_cannot_be_loaded_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = tmp_path / "libnvrtc.so.13"
    broken.write_bytes(b"no library")
    monkeypatch.setattr(compiler, "libraries", lambda: [broken])
    with pytest.raises(KernelError, match=r"NVRTC cannot be loaded \(.*libnvrtc\.so\.13"):
        compiler.load.__wrapped__()
