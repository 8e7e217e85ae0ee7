"""Drives a real Blender window on a virtual screen: mouse, keys, pictures, and Python inside.

Needs the programs Xvfb, xdotool and ImageMagick's `import` and `convert`.
"""

from __future__ import annotations

import json
import os
import queue
import shutil
import subprocess
import threading
import time
from pathlib import Path
from types import TracebackType
from typing import Any

REPOSITORY = Path(__file__).resolve().parents[2]
INSIDE = Path(__file__).with_name("inside.py")
PROGRAMS = ("Xvfb", "xdotool", "import", "convert")
STEP = 9
"""Pixels between places that are searched for a button; half of a button's height."""
COVERED = 26
"""Pixels at the sidebar's top that the editor's header may cover, so clicks miss the sidebar."""


class WindowError(Exception):
    """The window did not do what was expected."""


class Screen:
    """A virtual screen."""

    def __init__(self, width: int, height: int) -> None:
        missing = [name for name in PROGRAMS if not shutil.which(name)]
        if missing:
            raise WindowError(f"Missing programs: {', '.join(missing)}")
        self.size = (width, height)
        reading, writing = os.pipe()
        self._process = subprocess.Popen(
            ["Xvfb", "-displayfd", str(writing), "-screen", "0", f"{width}x{height}x24"],
            pass_fds=[writing],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(writing)
        with os.fdopen(reading) as numbers:
            self.display = f":{numbers.readline().strip()}"
        self.variables = os.environ | {"DISPLAY": self.display, "LIBGL_ALWAYS_SOFTWARE": "1"}

    def do(self, *command: str) -> None:
        """Run `xdotool` with these words."""
        subprocess.run(["xdotool", *command], env=self.variables, check=True)

    def picture(self, path: Path, crop: str = "", *options: str) -> None:
        """Write the screen as a PNG with a small palette; `crop` is ImageMagick's WxH+X+Y."""
        path.parent.mkdir(parents=True, exist_ok=True)
        whole = path.with_suffix(".whole.png")
        subprocess.run(["import", "-window", "root", whole], env=self.variables, check=True)
        cut = ["-crop", crop, "+repage"] if crop else []
        subprocess.run(["convert", whole, *cut, *options, "-strip", path], check=True)
        whole.unlink()

    def place_of(self, name: str) -> str:
        """The place of the window with this title, as ImageMagick's WxH+X+Y."""
        found = subprocess.run(
            ["xdotool", "search", "--name", name, "getwindowgeometry", "--shell"],
            env=self.variables,
            check=True,
            capture_output=True,
            text=True,
        )
        values = dict(line.split("=") for line in found.stdout.split() if "=" in line)
        return "{WIDTH}x{HEIGHT}+{X}+{Y}".format(**values)

    def close(self) -> None:
        """End the screen."""
        self._process.terminate()
        self._process.wait()


class Blender:
    """A running Blender with a window; use it in a `with` statement."""

    def __init__(
        self,
        program: Path,
        screen: Screen,
        resources: Path,
        *,
        log: Path,
        arguments: tuple[str, ...] = (),
        variables: dict[str, str] | None = None,
    ) -> None:
        """Start Blender, and wait until it answers.

        Args:
            program: Blender's executable.
            screen: the screen for its window, which fills it.
            resources: folder for its settings and extensions.
            log: file for its output.
            arguments: more arguments, such as a .blend file.
            variables: more environment variables.
        """
        self.screen, self.log = screen, log
        self._number = 0
        self._found: dict[tuple[str, float], tuple[int, int]] = {}
        self._answers: queue.SimpleQueue[list[Any]] = queue.SimpleQueue()
        width, height = screen.size
        geometry = ["--window-geometry", "0", "0", str(width), str(height)]
        self.process = subprocess.Popen(
            [program, *geometry, *arguments, "--python", INSIDE],
            env=screen.variables
            | {"BLENDER_USER_RESOURCES": str(resources), "PYTHONUNBUFFERED": "1"}
            | (variables or {}),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        threading.Thread(target=self._read, daemon=True).start()
        self.ask("bpy.context.preferences.view.show_splash", seconds=90)

    def __enter__(self) -> Blender:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.kill()

    def kill(self) -> None:
        """End Blender at once."""
        self.process.kill()
        self.process.wait()

    def quit(self) -> None:
        """Quit Blender with Ctrl-Q, as a user does; the file must be saved."""
        self.press("ctrl+q")
        try:
            self.process.wait(60)
        except subprocess.TimeoutExpired:
            raise WindowError("Blender did not quit at Ctrl-Q") from None

    def ask(self, code: str, seconds: float = 60.0) -> Any:
        """Evaluate an expression inside Blender; statements return None.

        Raises:
            WindowError: it failed there, or there was no answer in time.
        """
        assert self.process.stdin is not None
        self._number += 1
        self.process.stdin.write(json.dumps([self._number, code]) + "\n")
        self.process.stdin.flush()
        end = time.monotonic() + seconds
        while True:
            try:
                number, good, value = self._answers.get(timeout=0.5)
            except queue.Empty:
                if self.process.poll() is not None:
                    raise WindowError(
                        f"Blender ended with status {self.process.returncode}, see {self.log}"
                    ) from None
                if time.monotonic() > end:
                    raise WindowError(f"No answer within {seconds} s to: {code}") from None
                continue
            if number == self._number:
                if not good:
                    raise WindowError(f"In Blender: {code}\n{value}")
                return value

    def until(self, code: str, seconds: float = 60.0) -> float:
        """Wait until an expression is true; returns the seconds it took."""
        start = time.monotonic()
        while not self.ask(code, max(60.0, seconds)):
            if time.monotonic() - start > seconds:
                raise WindowError(f"Not so within {seconds} s: {code}")
            time.sleep(0.05)
        return time.monotonic() - start

    def pause(self, seconds: float) -> None:
        """Wait, so that Blender can draw."""
        time.sleep(seconds)

    def find(self, command: str, x: float = 0.5) -> tuple[int, int]:
        """Find the sidebar's button for a command such as `roigs.train_roi`; returns its place.

        Args:
            command: a part of the Python command.
            x: the column to search, as a share of the sidebar's width.

        Raises:
            WindowError: there is no such button.
        """
        before = self._found.get((command, x))
        if before is not None and command in self._command_at(*before):
            return before
        left, top, width, height = self.ask("sidebar()")
        column = left + int(x * width)
        for turn in range(6):
            for y in range(top + COVERED, top + height - 4, STEP):
                if command in self._command_at(column, y):
                    self._found[command, x] = (column, y + 3)
                    return column, y + 3
            self.scroll(-100 if turn == 0 else 8)
        raise WindowError(f"There is no button for {command} in the sidebar.")

    def _command_at(self, x: int, y: int) -> str:
        self.screen.do("mousemove", str(x), str(y))
        time.sleep(0.03)
        return str(self.ask("under_mouse()"))

    def type(self, text: str) -> None:
        """Type letters and numbers."""
        self.screen.do("type", "--delay", "30", "--", text)

    def choose(self, path: Path) -> None:
        """Choose a folder or file in the open file browser, and confirm with Enter.

        The path is set as if typed. The file browser must be in the main window.
        """
        self.until("file_browser() is not None and file_browser().spaces.active.params")
        folder, name = (path, "") if path.is_dir() else (path.parent, path.name)
        self.ask(
            "p = file_browser().spaces.active.params;"
            f" p.directory = {os.fsencode(folder)!r}; p.filename = {name!r}"
        )
        x, y = self.ask("[(a.x + a.width // 2, a.y + a.height // 2) for a in [file_browser()]][0]")
        height = self.ask("manager().windows[0].height")
        self.screen.do("mousemove", str(x), str(height - y))
        self.pause(0.5)
        self.press("Return")
        self.until("file_browser() is None")

    def scroll(self, steps: int) -> None:
        """Turn the wheel over the sidebar; negative `steps` scroll up."""
        left, top, _, height = self.ask("sidebar()")
        self.screen.do("mousemove", str(left + 5), str(top + height // 2))  # avoids lists
        button = "5" if steps > 0 else "4"
        self.screen.do("click", "--repeat", str(abs(steps)), "--delay", "10", button)
        time.sleep(0.5)

    def click(self, place: tuple[int, int]) -> float:
        """Click a place; returns the time of the press, seconds since 1970."""
        self.screen.do("mousemove", str(place[0]), str(place[1]))
        time.sleep(0.2)
        now = time.time()
        self.screen.do("click", "1")
        return now

    def press(self, *keys: str) -> float:
        """Press keys; returns the time, seconds since 1970."""
        now = time.time()
        self.screen.do("key", *keys)
        return now

    def _read(self) -> None:
        assert self.process.stdout is not None
        with self.log.open("a", encoding="utf-8") as log:
            for line in self.process.stdout:
                if line.startswith("@answer "):
                    self._answers.put(json.loads(line[len("@answer ") :]))
                else:
                    log.write(line)
                    log.flush()


def built_extension(program: Path, folder: Path) -> Path:
    """Build the extension as a zip in a folder."""
    _extension(program, {}, "build", "--source-dir", REPOSITORY, "--output-dir", folder)
    (archive,) = folder.glob("*.zip")
    return archive


def with_extension(program: Path, folder: Path) -> Path:
    """Build the extension and install it into fresh settings; returns their folder."""
    resources = folder / "resources"
    resources.mkdir(parents=True)
    archive = built_extension(program, folder)
    own = {"BLENDER_USER_RESOURCES": str(resources)}
    _extension(program, own, "install-file", "--repo", "user_default", "--enable", archive)
    return resources


def _extension(program: Path, variables: dict[str, str], *words: str | Path) -> None:
    done = subprocess.run(
        [program, "--command", "extension", *words],
        env=os.environ | variables,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise WindowError(f"{done.stdout}{done.stderr}")
