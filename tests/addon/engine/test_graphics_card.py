"""Answers of NVIDIA's driver, and the matching build of torch; with made-up drivers."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from roigs_addon.engine import graphics_card
from roigs_addon.engine.graphics_card import Card, choose, find

OLD_SMI = """
import sys
if "compute_cap" in sys.argv[1]:
    print('Field "compute_cap" is not a valid field to query.')
    sys.exit(2)
print("NVIDIA GeForce RTX 2060, 470.57.02")
"""


def smi(code: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make this code the computer's nvidia-smi."""
    script = folder / "smi.py"
    script.write_text(code, encoding="utf-8")
    run = graphics_card.subprocess.run

    def started(command: list[str], **options: object) -> object:
        assert command[0] == "/there/nvidia-smi"
        return run([sys.executable, str(script), *command[1:]], **options)

    monkeypatch.setattr(graphics_card.subprocess, "run", started)
    monkeypatch.setattr(graphics_card, "_programs", lambda: iter(["/there/nvidia-smi"]))


@pytest.mark.parametrize(
    ("code", "card"),
    [
        (
            "print('NVIDIA GeForce RTX 4070, 580.95.05, 8.9')",
            Card(name="NVIDIA GeForce RTX 4070", driver="580.95.05", capability=(8, 9)),
        ),
        (
            "print('NVIDIA T400, 581.15, 7.5'); print('NVIDIA RTX A4000, 581.15, 8.6')",
            Card(name="NVIDIA RTX A4000", driver="581.15", capability=(8, 6)),
        ),
        (OLD_SMI, Card(name="NVIDIA GeForce RTX 2060", driver="470.57.02", capability=None)),
        (
            "print('NVIDIA GeForce 940MX, 551.23, [N/A]')",
            Card(name="NVIDIA GeForce 940MX", driver="551.23", capability=None),
        ),
        ("print('No devices were found')", None),
        ("print('NVIDIA-SMI has failed: no driver'); raise SystemExit(9)", None),
        ("print('a, b, c'); print(); print(',,,')", None),
        ("import os; os.write(1, bytes(range(256)))", None),
    ],
)
def test_what_the_driver_says(
    code: str, card: Card | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    smi(code, tmp_path, monkeypatch)
    assert find() == card


def test_a_driver_that_hangs_is_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(graphics_card, "SECONDS", 0.2)
    smi("import time; time.sleep(60)", tmp_path, monkeypatch)
    assert find() is None


def test_without_a_driver(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(graphics_card, "find_program", lambda name: None)
    monkeypatch.setattr(Path, "is_file", lambda self: False)
    assert find() is None


@pytest.mark.parametrize("place", ["C:/Windows/System32", "C:/PF/NVIDIA Corporation/NVSMI"])
def test_where_windows_has_it(place: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Newer drivers have it in the first folder, older ones in the second, both off the path."""
    monkeypatch.setattr(graphics_card.sys, "platform", "win32")
    monkeypatch.setattr(graphics_card, "find_program", lambda name: None)
    monkeypatch.setenv("SYSTEMROOT", "C:/Windows")
    monkeypatch.setenv("PROGRAMW6432", "C:/PF")
    monkeypatch.setattr(Path, "is_file", lambda self: self == Path(place, "nvidia-smi.exe"))
    assert list(graphics_card._programs()) == [str(Path(place, "nvidia-smi.exe"))]


@pytest.mark.parametrize(
    ("driver", "capability", "platform", "build", "reason"),
    [
        ("580.95.05", (8, 9), "linux", "cu130", "RTX, driver 580.95.05."),
        ("580.88", (12, 0), "win32", "cu130", "RTX, driver 580.88."),
        ("610.1", (7, 5), "linux", "cu130", "RTX"),
        ("600.1", None, "linux", "cu130", "RTX"),
        ("575.57.08", (8, 9), "linux", "cu126", "RTX"),
        ("525.60.13", (7, 5), "linux", "cu126", "RTX"),
        ("525.60.11", (7, 5), "linux", "", "update the driver to 580"),
        ("527.41", (8, 6), "win32", "cu126", "RTX"),
        ("526.98", (8, 6), "win32", "", "update the driver to 580"),
        ("576.02", (12, 0), "win32", "", "update the driver to 580"),
        ("581.15", (6, 1), "win32", "", "this card is too old"),
        ("470.57.02", None, "linux", "", "update the driver to 580"),
    ],
)
def test_the_build_for_a_card(
    driver: str, capability: tuple[int, int] | None, platform: str, build: str, reason: str
) -> None:
    choice = choose(Card(name="RTX", driver=driver, capability=capability), platform)
    assert (choice.build.name if choice.build else "") == build
    assert reason in choice.reason and "\n" not in choice.reason


def test_without_a_card_it_is_the_cpu() -> None:
    choice = choose(None)
    assert choice.build is None and "No NVIDIA card" in choice.reason
