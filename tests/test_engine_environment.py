"""Set-up: what is removed from the engine's environment, and the try of what is left."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

TOOLS = Path(__file__).resolve().parent.parent / "tools"


def load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, TOOLS / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_tests_and_headers_go_and_packages_stay(tmp_path: Path) -> None:
    headers = ("torch/include/torch/all.h", "torch/bin/protoc", "torch/lib/dnnl.lib")
    tests = ("torch/test/op_test", "torch/bin/test_api", "scipy/stats/tests/test_fit.py")
    kept = (
        "torch/bin/torch_shm_manager",
        "torch/lib/libtorch_cpu.so",
        "torch/testing/__init__.py",
        "numpy/_core/tests/_natype.py",
        "jinja2/tests.py",
    )
    for name in (*headers, *tests, *kept):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(bytes(10))
    gone = (*tests, *headers)
    assert load("trim_engine").trim(tmp_path) == 10 * len(gone)
    left = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()}
    assert left == {*headers, *tests, *kept} - set(gone)


def test_what_a_link_leads_to_is_not_removed(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file").touch()
    (tmp_path / "packages" / "torch").mkdir(parents=True)
    try:
        (tmp_path / "packages" / "torch" / "include").symlink_to(tmp_path / "other")
    except OSError:
        pytest.skip("no links here")
    assert load("trim_engine").trim(tmp_path / "packages") == 0
    assert (tmp_path / "other" / "file").exists()


def test_a_python_that_is_no_environment_is_left_alone() -> None:
    base = Path(sys.base_prefix, "bin", "python3")
    if not base.exists():
        pytest.skip("no such program")
    command = [str(base), str(TOOLS / "trim_engine.py")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "not an environment of its own" in done.stderr


def test_the_try_says_which_command_does_not_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    script = load("try_engine")
    assert script.run(["inspect", str(tmp_path / "nothing")], tmp_path) == 2
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith("ERROR: inspect does not work: ") and "nothing" in last


@pytest.mark.slow
def test_the_engine_of_this_environment_works() -> None:
    command = [sys.executable, str(TOOLS / "try_engine.py")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert done.stdout.splitlines()[-2:] == ["select: works", "run: works"]
