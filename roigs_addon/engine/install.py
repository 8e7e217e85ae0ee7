"""Creates a Python environment for the engine, step by step, in a thread. No bpy.

Environments are in numbered folders. A folder counts once it contains its marker, which is written
last. A virtual environment cannot be moved, so none is renamed.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import threading
from pathlib import Path
from typing import IO

from ..errors import AddonError
from .base_python import choose_python
from .command import HIDDEN, variables
from .environments import DOWNLOADS, SETUP_LOG, alone, made, remove_replaced
from .install_steps import Plan, Step, requirements, steps
from .programs import windows_tool
from .python import MARKER, environment_python

_CONNECTION = re.compile(
    "PIP_((EXTRA_)?INDEX_URL|NO_INDEX|FIND_LINKS|TRUSTED_HOST|PROXY|(CLIENT_)?CERT|CONFIG_FILE"
    "|(DEFAULT_)?TIMEOUT|RETRIES|KEYRING_PROVIDER)"
)
"""pip's variables for its connection. The others are removed: they could change the set-up."""
LEAST_FREE = 20e6
"""Bytes of free disk space; below this, a failed step has probably run out of space."""
_RAW_PROGRESS = re.compile(r"Progress (\d+) of (\d+)")


class Installation:
    """Makes one environment. Its attributes may be read at any time, from any thread.

    Attributes:
        folder: of the environments.
        title: of the current step.
        line: the last line printed by a program.
        fraction: progress over all steps, 0 to 1.
        finished: whether it has ended, successfully or not.
        message: why it failed; empty while it runs and after success.
        stopped: whether it was stopped on request.
        python: that of the environment, after success.
    """

    def __init__(self, plan: Plan) -> None:
        """Prepare the installation; call `start` to begin."""
        self.plan = plan
        self.folder = plan.environments[0]
        self.log = self.folder / SETUP_LOG
        self.title, self.line, self.message = "Looking for a Python", "", ""
        self.fraction = 0.0
        self.finished = self.stopped = False
        self.python: Path | None = None
        self._said: list[str] = []
        self._process: subprocess.Popen[str] | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        """Start the installation in a thread."""
        self._thread.start()

    def stop(self, timeout: float = 5.0) -> None:
        """Stop the installation and the programs that it started."""
        self.stopped = True
        process = self._process
        if process is not None:
            _end(process)
        if self._thread.is_alive():
            self._thread.join(timeout)

    def _run(self) -> None:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with alone(self.folder):
                self._make()
        except AddonError as error:
            self.message = str(error)
        except OSError as error:
            self.message = f"The environment cannot be made ({error})."
        finally:
            if self.stopped:
                self.message = "Setting up was stopped."
            self.finished = True

    def _make(self) -> None:
        base = choose_python(self.plan.wheels)
        self.title = "Cleaning up"
        before = [int(path.name) for path in made([self.folder])]
        remove_replaced(self.plan.environments)
        environment = self.folder / str(max(before, default=0) + 1)
        self.log.unlink(missing_ok=True)  # so that no link or pipe in its place is written to
        with self.log.open("x", encoding="utf-8") as log:
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
        shutil.rmtree(self.folder / DOWNLOADS, ignore_errors=True)
        remove_replaced(self.plan.environments)

    def _run_step(self, step: Step, log: IO[str], begin: float, share: float) -> None:
        """Run one program to its end; its output goes to the log.

        Raises:
            AddonError: a needed step failed.
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
            env=self._variables(step),
            cwd=self.folder,  # our own folder, without untrusted files
            text=True,
            encoding="utf-8",
            errors="replace",
            start_new_session=os.name != "nt",  # so that pip's own children end too
            creationflags=HIDDEN,
        )
        if self.stopped:
            _end(process)
        assert process.stdout is not None
        with process.stdout as lines:
            for line in lines:
                progress = _RAW_PROGRESS.match(line)
                if progress:
                    done = int(progress[1]) / max(int(progress[2]), 1)
                    self.fraction = begin + share * min(done, 1.0)
                elif line.strip():
                    self.line = line.strip()
                    self._said.append(self.line)
                    print(self.line, file=log, flush=True)
        if process.wait() and not self.stopped:
            if not step.needed:
                print("The engine works without it.", file=log, flush=True)
                return
            said = f"{step.title} failed: {useful(self._said)}{self._of_the_disk()}"
            raise AddonError(f"{said} See the log {self.log}")

    def _of_the_disk(self) -> str:
        """Return advice if the disk is full: most programs do not name this cause."""
        with contextlib.suppress(OSError):
            if shutil.disk_usage(self.folder).free < LEAST_FREE:
                return f" The disk of {self.folder} is full: free some space."
        return ""

    def _variables(self, step: Step) -> dict[str, str]:
        raw = {"PIP_PROGRESS_BAR": "raw"} if step.title.startswith("Installing") else {}
        if self.plan.wheels is not None:  # this pip may be too old for it
            raw = {}
        # Python compiles a module when it is first used; most never are.
        pip = {"PIP_COMPILE": "0", "PIP_CACHE_DIR": str(self.folder / DOWNLOADS)}
        kept = {
            name: value
            for name, value in variables().items()
            if not name.startswith("PIP_") or _CONNECTION.fullmatch(name)
        }
        python = {"PYTHONUNBUFFERED": "1", "PYTHONUTF8": "1", "PYTHONNOUSERSITE": "1"}
        return kept | pip | python | raw


def _end(process: subprocess.Popen[str]) -> None:
    """Kill a program and its child processes."""
    if os.name == "nt":
        command = [windows_tool("taskkill"), "/T", "/F", "/PID", str(process.pid)]
        subprocess.run(command, capture_output=True, check=False, creationflags=HIDDEN)
        return
    with contextlib.suppress(ProcessLookupError, PermissionError):  # it has ended
        os.killpg(process.pid, signal.SIGKILL)


def useful(lines: list[str]) -> str:
    """Return the line with the cause of a failure: pip's last ERROR, else the last line."""
    errors = [line for line in lines if line.startswith("ERROR:")]
    line = (errors or lines or ["no output."])[-1].removeprefix("ERROR:").strip()
    return line if line.endswith(".") else f"{line}."


current: Installation | None = None
"""The running installation, or the last one."""


def running() -> bool:
    """Whether an environment is being made."""
    return current is not None and not current.finished


def begin(plan: Plan) -> Installation:
    """Start an installation.

    Raises:
        AddonError: one is running already.
    """
    global current
    if running():
        raise AddonError("The engine is already being set up.")
    current = Installation(plan)
    current.start()
    return current


def forget() -> None:
    """Stop a running installation, and forget it."""
    global current
    if current is not None and not current.finished:
        current.stop()
    current = None
