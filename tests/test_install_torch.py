"""Set-up: which torch is installed."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def script() -> ModuleType:
    path = ROOT / "tools" / "install_torch.py"
    spec = importlib.util.spec_from_file_location("install_torch", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def report(*packages: tuple[str, str]) -> dict[str, object]:
    return {"install": [{"metadata": {"name": n, "version": v}} for n, v in packages]}


@pytest.mark.parametrize(
    "packages",
    [
        [("torch", "2.13.0"), ("nvidia-cublas-cu12", "12.8"), ("triton", "3.4")],
        [("torch", "2.13.0"), ("nvidia_cublas", "13.0")],
        [("torch", "2.13.0"), ("cuda-bindings", "13.0")],
        [("torch", "2.13.0"), ("triton", "3.4")],
        [("torch", "2.13.0+cu130")],
    ],
)
def test_a_cuda_build_is_passed_over_for_the_cpu_index(
    script: ModuleType, packages: list[tuple[str, str]]
) -> None:
    assert script.choose_index(report(*packages), "linux") == script.CPU_INDEX


@pytest.mark.parametrize(
    "packages",
    [
        [("torch", "2.13.0+cpu"), ("sympy", "1.14"), ("filelock", "4")],
        [("torch", "2.13.0"), ("numpy", "2.4"), ("cudf", "1")],
        [],
    ],
)
def test_a_cpu_build_comes_from_where_pip_finds_it(
    script: ModuleType, packages: list[tuple[str, str]]
) -> None:
    assert script.choose_index(report(*packages), "linux") is None


def test_without_an_answer_linux_is_safe(script: ModuleType) -> None:
    assert script.choose_index(None, "linux") == script.CPU_INDEX
    assert script.choose_index(None, "win32") is None
    assert script.choose_index(None, "darwin") is None


def test_the_pin_is_read_from_pyproject(script: ModuleType, tmp_path: Path) -> None:
    assert script.wanted_torch() == "torch==2.13.0"
    other = tmp_path / "pyproject.toml"
    text = '[project]\ndependencies = ["numpy", "torch-scatter", "torch == 9.1"]\n'
    other.write_text(text, encoding="utf-8")
    assert script.wanted_torch(other) == "torch == 9.1"


def test_an_installed_torch_of_any_build_will_do(
    script: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(script.metadata, "version", lambda name: "2.13.0+cpu")
    assert script.installed("torch==2.13.0")
    assert not script.installed("torch==2.13.1")
