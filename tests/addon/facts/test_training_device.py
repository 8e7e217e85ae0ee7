"""The training device: panel and preferences repeat the engine's words."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from roigs_engine.context import Context
from roigs_engine.formats import events
from tests.addon.fake_engine import fake, until

pytestmark = pytest.mark.blender

CARD = 'say(event="device", kind="cuda", name="NVIDIA RTX 4070", reason="checked")'
FAILED = 'say(event="device", kind="cpu", name="", reason="GPU check: differs from the CPU")'
_engines = 0
DONE = 'say(event="done", outputs={}, stopped=False)'


def panel(bpy: ModuleType) -> list[str]:
    """The lines about the device in the panel, as one."""
    from roigs_addon.ui.train import TrainPanel
    from tests.addon.panels import said

    texts = said(bpy, TrainPanel)
    starts = [k for k, text in enumerate(texts) if text.startswith("Trains on ")]
    return [" ".join(texts[k : k + 3]) for k in starts]


def train(code: str, folder: Path) -> None:
    from roigs_addon.jobs import current
    from roigs_addon.jobs.spec import TRAINING, JobSpec

    log = folder / "blender" / "engine.log"
    spec = JobSpec(title=TRAINING, arguments=["train"], log=log)
    global _engines
    _engines += 1
    current.wait(current.start(fake(folder / f"engine {_engines}", code), spec))


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (CARD, "Trains on NVIDIA RTX 4070 (checked)"),
        (FAILED, "Trains on the processor (GPU check: differs from the CPU)"),
    ],
)
def test_the_panel_says_it_of_the_training_and_of_its_log(
    code: str,
    words: str,
    blender: ModuleType,
    addon: ModuleType,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from roigs_addon.jobs import current

    scene = blender.context.scene
    scene.roigs.run_dir = str(tmp_path)
    assert panel(blender) == []  # nothing was said, so nothing is known
    train(f"{code}\n{DONE}", tmp_path)
    (said,) = panel(blender)
    assert said.startswith(words)
    assert words in capsys.readouterr().err  # blender -b
    current.job = current._training = None  # as when Blender is opened again
    assert panel(blender) == [said]
    train(DONE, tmp_path)  # one that says nothing
    current.job = current._training = None
    scene.roigs.run_dir = str(tmp_path / "another")
    assert panel(blender) == []


def test_a_torch_without_cuda_says_what_to_do(
    blender: ModuleType, addon: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("torch")  # the Blender of `make test-blender` has none
    from roigs_addon.facts import training_device
    from roigs_engine.cuda.device import choose_device

    said: list[events.Event] = []
    monkeypatch.setattr("torch.version.cuda", None)
    choose_device("auto", Context(emit=said.append))
    (record,) = [events.parse_event(events.to_json(event)) for event in said]
    assert record is not None
    monkeypatch.setattr("sys.platform", "linux")
    assert training_device.in_words(events.device_in_words(record)) == (
        "Trains on the processor. For an NVIDIA card: Set Up the Engine"
    )


def test_damaged_events_do_no_harm(blender: ModuleType, addon: ModuleType, tmp_path: Path) -> None:
    blender.context.scene.roigs.run_dir = str(tmp_path)
    train(f'say(event="device", kind=3, name=[], reason="a\\nb")\n{DONE}', tmp_path)
    (said,) = panel(blender)
    assert said.startswith("Trains on the processor (a b)")


def test_check_asks_the_engine(
    blender: ModuleType, addon: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon import settings
    from roigs_addon.engine import check, python
    from roigs_addon.facts import training_device
    from roigs_addon.ui import preferences

    asked = tmp_path / "asked"
    code = f"open({str(asked)!r}, 'a').write(' '.join(sys.argv[1:]) + ';')\n{CARD}"
    engine = fake(tmp_path, f"{code}\n{DONE}")
    monkeypatch.setattr(python, "find", lambda *_: (engine, ""))
    monkeypatch.setattr(check, "check", lambda *_: ())
    training_device.forget()
    assert blender.ops.roigs.check_engine() == {"FINISHED"}
    assert until(lambda: not training_device._check.busy())
    assert asked.read_text() == "check-gpu --brief --device auto --events;"
    assert training_device.asked() == "NVIDIA RTX 4070 (checked)"
    assert panel(blender)[0].startswith("Trains on NVIDIA RTX 4070")
    drawn: list[str] = []
    monkeypatch.setattr(preferences, "_lines", lambda _layout, text, _icon: drawn.append(text))
    from tests.addon.panels import Layout

    page = SimpleNamespace(build="CPU", formats=True, wheels="")
    preferences._draw_engine(Layout([]), page)
    assert "Trains on NVIDIA RTX 4070 (checked)" in drawn
    chosen = SimpleNamespace(device="cpu", engine_python="")
    monkeypatch.setattr(settings, "get", lambda: chosen)
    assert not training_device.asked()  # of another device, nothing is known
    refused = 'say(event="failed", message="There is no GPU.", hint="")\nsys.exit(2)'
    monkeypatch.setattr(python, "find", lambda *_: (fake(tmp_path / "2", refused), ""))
    training_device.ask()
    assert until(lambda: not training_device._check.busy())
    said = training_device.in_words(training_device.asked())
    assert said.startswith("Cannot train: There is no GPU.")
    monkeypatch.setattr(python, "find", lambda *_: (None, "none"))
    training_device.forget()
    training_device.ask()
    assert until(lambda: not training_device._check.busy()) and not training_device.asked()
