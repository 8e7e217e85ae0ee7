"""Makes a Python environment for the engine, step by step, in a thread. No bpy.

Environments live in numbered folders. A folder counts once it holds its marker, which is written
last; a virtual environment cannot be moved after it was made, so there is no renaming. What is
installed, and in which versions, stands in pyproject.toml alone, which the extension carries.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
import threading
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from ..errors import AddonError
from .client import without_blender
from .python import (
    FOR_TRAINING,
    MARKER,
    SOURCE,
    environment_python,
    own_python,
    whole_environments,
)

CUDA_INDEX = "https://download.pytorch.org/whl/cu130"
PYTHONS = ((3, 13), (3, 12), (3, 11), (3, 14))
"""Versions that torch has wheels for, in the order in which they are looked for."""

PROBE_SECONDS = 20.0
# Where macOS keeps Pythons that programs started from the Dock do not see.
MAC_FOLDERS = ("/opt/homebrew/bin", "/usr/local/bin")

_PROBE = "import ensurepip, venv, sys; print(*sys.version_info[:2])"
_RAW_PROGRESS = re.compile(r"Progress (\d+) of (\d+)")
_HIDDEN = 0x08000000 if os.name == "nt" else 0  # CREATE_NO_WINDOW


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What to install and from where.

    Attributes:
        home: folder of the environments.
        cuda: torch for NVIDIA's graphics cards in place of the one for the CPU, and gsplat.
        wheels: folder to install from, without a network; None: PyPI and PyTorch's index.
        in_use: whether an engine runs, maybe in the environment before; called at the end.
    """

    home: Path
    cuda: bool = False
    wheels: Path | None = None
    in_use: Callable[[], bool] = lambda: False


@dataclass(frozen=True, kw_only=True)
class Step:
    """One program that runs to its end."""

    title: str
    command: list[str]


def requirements(*extras: str, pyproject: Path = SOURCE / "pyproject.toml") -> list[str]:
    """What training needs, and more for the extras of the project, as pip takes it."""
    project = tomllib.loads(pyproject.read_text(encoding="utf-8"))["project"]
    optional = project["optional-dependencies"]
    return [
        *project["dependencies"],
        *(needed for extra in ("train", *extras) for needed in optional[extra]),
    ]


def wheel_versions(folder: Path) -> set[tuple[int, int]]:
    """The Pythons that the wheels of torch in a folder are for."""
    tags = (re.search(r"-cp3(\d+)-", wheel.name) for wheel in folder.glob("torch-*.whl"))
    return {(3, int(tag[1])) for tag in tags if tag}


def choose_python(wheels: Path | None = None) -> Path:
    """A Python that can make the environment: Blender's own, or one found on this computer.

    Raises:
        AddonError: there is none, or the folder has no torch.
    """
    allowed = set(PYTHONS)
    if wheels is not None:
        allowed = wheel_versions(wheels)
        if not allowed:
            raise AddonError(f"{wheels} holds no wheel of torch. Choose the folder that does.")
    for command in _pythons():
        if _version(command) in allowed:
            return _program(command)
    names = " or ".join(f"3.{minor}" for _, minor in sorted(allowed))
    debian = " (on Debian and Ubuntu with python3-venv)" if sys.platform == "linux" else ""
    raise AddonError(f"No Python to make the environment with. Install Python {names}{debian}.")


def _pythons() -> Iterator[list[str]]:
    """Command lines of Pythons to try."""
    yield [str(own_python())]
    folders = [os.environ.get("PATH", "")]
    if sys.platform == "darwin":
        folders += MAC_FOLDERS
    path = os.pathsep.join(folders)
    launcher = shutil.which("py") if os.name == "nt" else None
    for major, minor in PYTHONS:
        if launcher:
            yield [launcher, f"-{major}.{minor}"]
        found = shutil.which(f"python{major}.{minor}", path=path)
        if found:
            yield [found]
    for name in ("python3", "python"):
        found = shutil.which(name, path=path)
        if found:
            yield [found]


def _version(command: list[str]) -> tuple[int, int]:
    """Version of a Python that can make environments; (0, 0) of anything else."""
    try:
        said = _ask(command, _PROBE)
        major, minor = said.split()
        return int(major), int(minor)
    except (OSError, subprocess.SubprocessError, ValueError):
        return 0, 0


def _program(command: list[str]) -> Path:
    """The program behind a command such as `py -3.11`."""
    if len(command) == 1:
        return Path(command[0])
    return Path(_ask(command, "import sys; print(sys.executable)"))


def _ask(command: list[str], code: str) -> str:
    result = subprocess.run(
        [*command, "-c", code],
        capture_output=True,
        text=True,
        timeout=PROBE_SECONDS,
        env=without_blender(os.environ),
        check=True,
        creationflags=_HIDDEN,
    )
    return result.stdout.strip()


def steps(plan: Plan, base: Path, environment: Path) -> list[Step]:
    """The programs that make `environment` with the Python `base`."""
    python = str(environment_python(environment))
    pip = [python, "-m", "pip", "install", "--no-input", "--disable-pip-version-check"]
    cuda = plan.cuda and platform.system() != "Darwin"
    wanted = requirements(*(["cuda"] if cuda else []))
    make = Step(title="Making the environment", command=[str(base), "-m", "venv", str(environment)])
    packages = ", ".join(FOR_TRAINING)
    check = Step(
        title="Trying it", command=[python, "-c", f"import {packages}; print(torch.__version__)"]
    )
    if plan.wheels is not None:
        source = ["--no-index", "--find-links", str(plan.wheels)]
        return [make, Step(title="Installing", command=[*pip, *source, *wanted]), check]
    index = ["--index", CUDA_INDEX] if cuda else []
    torch = [python, str(SOURCE / "tools" / "install_torch.py"), *index]
    return [
        make,
        # From this version on, pip tells how much of a file it has.
        Step(title="Updating pip", command=[*pip, "pip>=24.1"]),
        Step(title="Installing torch", command=torch),
        Step(title="Installing the rest", command=[*pip, *wanted]),
        check,
    ]


class Installation:
    """One making of an environment. Its attributes may be read at any time, from any thread.

    Attributes:
        title: what it is doing.
        line: the last line that a program wrote.
        fraction: share of all steps that is done, 0 to 1.
        finished: whether it has ended, in one way or another.
        message: why it failed; empty while it runs and after success.
        stopped: whether it was ended on request.
        python: the environment's, after success.
    """

    def __init__(self, plan: Plan) -> None:
        """Prepare it; `start` begins."""
        self.plan = plan
        self.log = plan.home / "setup.log"
        self.title, self.line, self.message = "Looking for a Python", "", ""
        self.fraction = 0.0
        self.finished = self.stopped = False
        self.python: Path | None = None
        self._said: list[str] = []
        self._process: subprocess.Popen[str] | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        """Begin, in a thread."""
        self._thread.start()

    def stop(self, timeout: float = 5.0) -> None:
        """End it and what it started."""
        self.stopped = True
        process = self._process
        if process is not None:
            _end(process)
        if self._thread.is_alive():
            self._thread.join(timeout)

    def _run(self) -> None:
        try:
            self._make()
        except AddonError as error:
            self.message = str(error)
        except OSError as error:
            self.message = f"The environment cannot be made ({error})."
        finally:
            if self.stopped:
                self.message = "The set-up was stopped."
            self.finished = True

    def _make(self) -> None:
        home = self.plan.home
        home.mkdir(parents=True, exist_ok=True)
        base = choose_python(self.plan.wheels)
        self.title = "Making room"
        before = [int(p.name) for p in home.iterdir() if p.is_dir() and p.name.isdecimal()]
        remove_replaced(home)
        environment = home / str(max(before, default=0) + 1)
        with self.log.open("w", encoding="utf-8") as log:
            planned = steps(self.plan, base, environment)
            for number, step in enumerate(planned):
                self.title, self.line = step.title, ""
                self.fraction = number / len(planned)
                self._run_step(step, log, number / len(planned), 1 / len(planned))
        if self.stopped:
            return
        record = {"requirements": requirements(), "base": str(base)}
        (environment / MARKER).write_text(json.dumps(record, indent=1), encoding="utf-8")
        self.python, self.fraction = environment_python(environment), 1.0
        self.title = "The engine is set up"
        if not self.plan.in_use():  # else the next set-up does it
            remove_replaced(home)

    def _run_step(self, step: Step, log: IO[str], begin: float, share: float) -> None:
        """One program to its end, its lines to the log.

        Raises:
            AddonError: it failed.
        """
        if self.stopped:
            return
        self._said.clear()
        print(f"\n{step.title}: {subprocess.list2cmdline(step.command)}", file=log, flush=True)
        self._process = process = subprocess.Popen(
            step.command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=without_blender(os.environ) | self._variables(step),
            text=True,
            encoding="utf-8",
            errors="replace",
            start_new_session=os.name != "nt",  # so that pip's own children can be ended too
            creationflags=_HIDDEN,
        )
        if self.stopped:
            _end(process)
        assert process.stdout is not None
        for line in process.stdout:
            progress = _RAW_PROGRESS.match(line)
            if progress:
                done = int(progress[1]) / max(int(progress[2]), 1)
                self.fraction = begin + share * min(done, 1.0)
            elif line.strip():
                self.line = line.strip()
                self._said.append(self.line)
                print(self.line, file=log, flush=True)
        if process.wait() and not self.stopped:
            raise AddonError(f"{step.title} failed: {useful(self._said)} The log: {self.log}")

    def _variables(self, step: Step) -> dict[str, str]:
        raw = {"PIP_PROGRESS_BAR": "raw"} if step.title.startswith("Installing") else {}
        if self.plan.wheels is not None:  # this pip may be too old for it
            raw = {}
        return {"PYTHONUNBUFFERED": "1", "PYTHONUTF8": "1", "PYTHONNOUSERSITE": "1"} | raw


def remove_replaced(home: Path) -> None:
    """Remove what set-ups have left that did not end, and every environment but the newest."""
    newest = whole_environments(home)[:1]
    for path in home.iterdir():
        if path.is_dir() and path not in newest:
            shutil.rmtree(path, ignore_errors=True)


def _end(process: subprocess.Popen[str]) -> None:
    """End a program with all that it has started."""
    if os.name == "nt":
        command = ["taskkill", "/T", "/F", "/PID", str(process.pid)]
        subprocess.run(command, capture_output=True, check=False, creationflags=_HIDDEN)
        return
    with contextlib.suppress(ProcessLookupError, PermissionError):  # it has ended
        os.killpg(process.pid, signal.SIGKILL)


def useful(lines: list[str]) -> str:
    """The line that says what went wrong: pip's last ERROR, or else the last line."""
    errors = [line for line in lines if line.startswith("ERROR:")]
    line = (errors or lines or ["it said nothing."])[-1].removeprefix("ERROR:").strip()
    return line if line.endswith(".") else f"{line}."


current: Installation | None = None
"""The one that runs, or the last one."""


def running() -> bool:
    """Whether an environment is being made."""
    return current is not None and not current.finished


def begin(plan: Plan) -> Installation:
    """Start one.

    Raises:
        AddonError: one runs already.
    """
    global current
    if running():
        raise AddonError("The engine is being set up already.")
    current = Installation(plan)
    current.start()
    return current


def forget() -> None:
    """End what runs, and forget it."""
    global current
    if current is not None and not current.finished:
        current.stop()
    current = None
