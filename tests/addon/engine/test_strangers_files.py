"""Files beside a .blend are never run: modules, programs, and what Python's variables lead to."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from roigs_addon.engine import (
    base_python,
    command,
    graphics_card,
    install,
    install_steps,
    programs,
    python,
)
from roigs_addon.engine.install_steps import Plan, Step

MODULES = ("venv", "pip", "ensurepip", "importlib", "json", "numpy", "torch", "tomllib")


@pytest.fixture
def strangers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with modules and programs that leave a file; what they would leave."""
    folder, left = tmp_path / "beside the blend", tmp_path / "left"
    leave = f"open({str(left)!r}, 'a').write('run')\n"
    for name in MODULES:
        (folder / name).mkdir(parents=True)
        (folder / name / "__init__.py").write_text(leave)
    startup = folder / "startup.py"
    startup.write_text(leave)
    for name in ("python3", "python3.11", "python3.13", "py", "nvidia-smi", "taskkill"):
        program = folder / (f"{name}.exe" if os.name == "nt" else name)
        program.write_text(f"#!/bin/sh\necho run >> '{left}'\n")
        program.chmod(0o755)
    (folder / "libstranger.so").write_bytes(b"no library")  # the loader would say so
    monkeypatch.chdir(folder)
    monkeypatch.setenv("PYTHONPATH", str(folder))
    monkeypatch.setenv("PYTHONSTARTUP", str(startup))
    monkeypatch.setenv("PATH", os.pathsep.join(["", ".", os.environ["PATH"]]))
    monkeypatch.delenv(python.VARIABLE, raising=False)
    python.ability.cache_clear()
    return left


def test_a_python_is_asked_in_isolation(strangers: Path) -> None:
    found = python.ability(Path(sys.executable))
    assert not found.fault and "numpy" not in found.missing
    assert base_python._version([sys.executable])[0] in (0, 3)
    for words in base_python._pythons():
        assert os.path.isabs(words[0]), words
    assert not strangers.exists()


def test_programs_of_the_working_folder_are_not_found(strangers: Path) -> None:
    for name in ("python3", "nvidia-smi", "py"):
        found = programs.find_program(name)
        assert found is None or found.parent != Path.cwd()
    graphics_card.find()
    assert not strangers.exists()


@pytest.mark.skipif(os.name == "nt", reason="variables of POSIX")
def test_the_working_folder_is_not_searched_for_libraries(
    strangers: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An empty entry is the working folder, and looks harmless."""
    monkeypatch.setenv("LD_LIBRARY_PATH", ":/opt/a:lib:/opt/b:")
    monkeypatch.setenv("DYLD_LIBRARY_PATH", "")
    monkeypatch.setenv("PATH", f":bin:{os.environ['PATH']}:.")
    for given in (command.variables(), command.Engine(python=Path("p"), source=Path("s"))):
        found = given if isinstance(given, dict) else given.environment()
        assert found["LD_LIBRARY_PATH"] == "/opt/a:/opt/b" and "DYLD_LIBRARY_PATH" not in found
        assert all(map(os.path.isabs, found["PATH"].split(":")))
    code = "import ctypes; ctypes.CDLL('libstranger.so')"
    run = subprocess.run(
        [sys.executable, "-I", "-c", code],
        env=command.variables(),
        capture_output=True,
        text=True,
        check=False,
    )
    assert "libstranger.so: cannot open" in run.stderr or "not found" in run.stderr, run.stderr


def test_each_step_of_the_set_up_is_isolated_and_runs_in_its_own_folder(
    strangers: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for plan in (Plan(environments=(tmp_path,)), Plan(environments=(tmp_path,), wheels=tmp_path)):
        for step in install_steps.steps(plan, Path(sys.executable), tmp_path / "1"):
            assert step.command[1] == "-I", step.title

    code = "import os, venv, json; print(os.getcwd(), sorted(os.environ))"
    isolated = Step(title="Look", command=[sys.executable, "-I", "-c", code])
    made = Step(
        title="Make",
        command=[sys.executable, "-I", "-c", f"import os; os.mkdir({str(tmp_path / 'e' / '1')!r})"],
    )
    monkeypatch.setattr(install, "steps", lambda *given: [made, isolated])
    monkeypatch.setattr(install, "choose_python", lambda wheels: Path(sys.executable))
    for name in ("PIP_TARGET", "PIP_USER", "PIP_REQUIREMENT"):
        monkeypatch.setenv(name, str(tmp_path))
    monkeypatch.setenv("PIP_INDEX_URL", "https://mirror.example/simple")
    installation = install.Installation(Plan(environments=(tmp_path / "e",)))
    installation._run()
    said = installation.log.read_text(encoding="utf-8")
    assert installation.message == "" and f"\n{tmp_path / 'e'} [" in said
    assert "PIP_INDEX_URL" in said and "PIP_TARGET" not in said and "PIP_USER" not in said
    assert "PYTHONPATH" not in said and "PYTHONSTARTUP" not in said
    assert not strangers.exists()


@pytest.mark.parametrize("named", ["//venv/bin/python", "venv/bin/python", "//../python"])
def test_a_python_beside_the_blend_is_refused(named: str, strangers: Path) -> None:
    program = Path("venv", "bin", "python")
    program.parent.mkdir(parents=True)
    program.write_text(f"#!/bin/sh\necho run >> '{strangers}'\n")
    program.chmod(0o755)
    engine, reason = python.find(named, [], ())
    assert engine is None and "not a full path; choose the program again" in reason
    assert not strangers.exists()
