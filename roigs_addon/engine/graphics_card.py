"""Finds the NVIDIA card and driver, and the matching build of torch. No bpy.

docs/cuda.md has the requirements of drivers and builds, with the sources.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from .command import HIDDEN, variables
from .programs import find_program

SECONDS = 20.0
"""Time limit of the driver's answer."""

FIELDS = ("name,driver_version,compute_cap", "name,driver_version")
"""Fields to query; drivers before 510 do not know compute_cap."""


@dataclass(frozen=True, kw_only=True)
class Card:
    """An NVIDIA card.

    Attributes:
        name: as the driver gives it.
        driver: the driver's version, such as "580.95.05".
        capability: compute capability, such as (8, 9); None if the driver does not say.
    """

    name: str
    driver: str
    capability: tuple[int, int] | None


@dataclass(frozen=True, kw_only=True)
class Build:
    """A build of torch for CUDA.

    Attributes:
        name: in PyTorch's index.
        driver: oldest supported driver, on Linux and on Windows.
        oldest, newest: range of compute capabilities that it and our kernels support.
    """

    name: str
    driver: tuple[tuple[int, ...], tuple[int, ...]]
    oldest: tuple[int, int]
    newest: tuple[int, int]

    @property
    def index(self) -> str:
        """Return the package index for pip."""
        return f"https://download.pytorch.org/whl/{self.name}"


BUILDS = (
    Build(name="cu130", driver=((580,), (580,)), oldest=(7, 5), newest=(12, 9)),
    Build(name="cu126", driver=((525, 60, 13), (527, 41)), oldest=(7, 5), newest=(9, 0)),
)
"""Builds by preference: the first that a card and its driver can use is installed."""


@dataclass(frozen=True, kw_only=True)
class Choice:
    """The build to install, and the reason, as a sentence for the user.

    Attributes:
        build: None for the build for the CPU.
        card: None if there is none, or its driver is not installed.
    """

    build: Build | None
    card: Card | None
    reason: str


def choose(card: Card | None, platform: str = sys.platform) -> Choice:
    """Choose the build of torch for a card; `platform` is as sys.platform."""
    if card is None:
        return Choice(build=None, card=None, reason="No NVIDIA card with a driver was found.")
    known = f"{card.name}, driver {card.driver}"
    if card.capability is not None and card.capability < BUILDS[0].oldest:
        reason = f"{known}: this card is too old for our kernels. The CPU trains."
        return Choice(build=None, card=card, reason=reason)
    for build in BUILDS:
        capability = card.capability or build.oldest
        needed = build.driver[platform == "win32"]
        if _numbers(card.driver) >= needed and build.oldest <= capability <= build.newest:
            return Choice(build=build, card=card, reason=f"{known}.")
    reason = f"{known}: update the driver to 580 or later, then set up the engine again."
    return Choice(build=None, card=card, reason=reason)


def find() -> Card | None:
    """Return the NVIDIA card; of several, the one with the highest compute capability.

    This runs the driver's own program instead of loading its library, so a crash stays outside
    Blender.
    """
    for program in _programs():
        for fields in FIELDS:
            cards = [card for line in _ask(program, fields) if (card := _card(line))]
            if cards:
                return max(cards, key=lambda card: card.capability or (0, 0))
    return None


def _programs() -> Iterator[str]:
    """Yield possible places of nvidia-smi: it is not always on the path of desktop programs."""
    if found := find_program("nvidia-smi"):
        yield str(found)
    places = [Path("/usr/bin"), Path("/usr/lib/wsl/lib"), Path("/run/current-system/sw/bin")]
    name = "nvidia-smi"
    if sys.platform == "win32":  # its variables' names may have any case
        name = "nvidia-smi.exe"
        windows = os.environ.get("SYSTEMROOT", r"C:\Windows")
        programs = os.environ.get("PROGRAMW6432") or os.environ.get("PROGRAMFILES", "")
        places = [
            Path(windows) / "System32",
            Path(programs or r"C:\Program Files") / "NVIDIA Corporation" / "NVSMI",
        ]
    for place in places:
        if (place / name).is_file():
            yield str(place / name)


def _ask(program: str, fields: str) -> list[str]:
    """Query nvidia-smi; return the lines of its answer, none if it fails."""
    try:
        result = subprocess.run(
            [program, f"--query-gpu={fields}", "--format=csv,noheader"],
            env=variables(),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            encoding="utf-8",
            errors="replace",
            timeout=SECONDS,
            check=False,
            creationflags=HIDDEN,
        )
    except (OSError, subprocess.TimeoutExpired):
        return []
    return result.stdout.splitlines() if result.returncode == 0 else []


def _card(line: str) -> Card | None:
    """Parse a line such as 'NVIDIA GeForce RTX 4070, 580.95.05, 8.9'."""
    name, *rest = (part.strip() for part in line.split(","))
    if not name or not rest or not _numbers(rest[0]):
        return None
    match = re.fullmatch(r"(\d+)\.(\d+)", rest[1]) if len(rest) > 1 else None
    capability = (int(match[1]), int(match[2])) if match else None
    printable = "".join(c if c.isprintable() else " " for c in name)
    return Card(name=printable, driver=rest[0], capability=capability)


def _numbers(version: str) -> tuple[int, ...]:
    """Parse a version: (580, 95, 5) for '580.95.05'; empty if it is not one."""
    if not re.fullmatch(r"\d+(\.\d+)*", version):
        return ()
    return tuple(int(part) for part in version.split("."))
