"""The preferences page: what a set-up takes, and removing it."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from roigs_addon.engine import python
from roigs_addon.engine.graphics_card import Card, choose

CARD = Card(name="NVIDIA GeForce RTX 4070", driver="580.95.05", capability=(8, 9))


@pytest.fixture
def environment(
    blender: ModuleType, addon: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Path:
    """A complete environment, in the folder that the add-on uses."""
    from roigs_addon import settings

    made = tmp_path / "engine" / "1"
    made.mkdir(parents=True)
    (made / python.MARKER).write_text("{}")
    (made / "data").write_bytes(bytes(3_000_000))
    monkeypatch.setattr(settings, "environments", lambda: (tmp_path / "engine", tmp_path / "old"))
    return made


def test_the_engine_is_removed(blender: ModuleType, environment: Path) -> None:
    assert blender.ops.roigs.remove_engine() == {"FINISHED"}
    assert not environment.exists()
    assert not blender.ops.roigs.remove_engine.poll()


def test_it_is_not_removed_while_something_works(
    blender: ModuleType, environment: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon.engine import environments, install
    from roigs_addon.jobs import current

    for module, name in ((install, "running"), (current, "busy")):
        with monkeypatch.context() as patch:
            patch.setattr(module, name, lambda: True)
            assert not blender.ops.roigs.remove_engine.poll()
    with (
        environments.using(python.environment_python(environment)),
        pytest.raises(RuntimeError, match=r"An engine is running \(process \d+\). Stop it first."),
    ):
        blender.ops.roigs.remove_engine()
    assert (environment / python.MARKER).is_file()


def test_the_question_says_what_it_frees(
    blender: ModuleType, environment: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from types import SimpleNamespace

    from roigs_addon.operators.engine_setup import RemoveEngine

    asked: dict[str, str] = {}

    def ask(_operator: object, _event: object, **texts: str) -> set[str]:
        asked.update(texts)
        return {"RUNNING_MODAL"}

    context = SimpleNamespace(window_manager=SimpleNamespace(invoke_confirm=ask))
    assert RemoveEngine.invoke(None, context, None) == {"RUNNING_MODAL"}
    assert asked["message"] == "This frees 3 MB. Runs and results stay."
    assert environment.is_dir()


def test_the_page_says_what_a_set_up_takes(blender: ModuleType, addon: ModuleType) -> None:
    from roigs_addon.ui import preferences

    for formats, size in ((False, "431 MB and takes 1311"), (True, "556 MB and takes 1831")):
        said = preferences._needed_space(SimpleNamespace(build="CPU", formats=formats), None)
        assert said == f"Downloads about {size} MB of disk space (on Linux)."
    for build, found, size in (
        ("CUDA", None, "2.6 GB"),
        ("AUTO", CARD, "2.6 GB"),
        ("AUTO", None, "431 MB"),
        ("CPU", CARD, "431 MB"),
    ):
        page = SimpleNamespace(build=build, formats=False)
        assert size in preferences._needed_space(page, choose(found))


def test_the_page_says_what_automatic_installs(blender: ModuleType, addon: ModuleType) -> None:
    from roigs_addon.ui import preferences

    assert preferences._what_suits(None).startswith("Asking")
    assert preferences._what_suits(choose(CARD)) == (
        "Automatic installs torch for CUDA (cu130). NVIDIA GeForce RTX 4070, driver 580.95.05."
    )
    assert preferences._what_suits(choose(None)) == (
        "Automatic installs torch for the CPU. No NVIDIA card with a driver was found."
    )


@pytest.mark.parametrize(
    ("build", "found", "index"),
    [
        ("AUTO", CARD, "https://download.pytorch.org/whl/cu130"),
        ("AUTO", None, ""),
        ("CPU", CARD, ""),
        ("CUDA", CARD, "https://download.pytorch.org/whl/cu130"),
        ("CUDA", None, "https://download.pytorch.org/whl/cu130"),
    ],
)
def test_a_set_up_installs_what_suits(
    build: str,
    found: Card | None,
    index: str,
    blender: ModuleType,
    addon: ModuleType,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from roigs_addon.engine import graphics_card as driver
    from roigs_addon.engine import install
    from roigs_addon.errors import AddonError
    from roigs_addon.facts import graphics_card

    plans: list[install.Plan] = []

    def begin(plan: install.Plan) -> None:
        plans.append(plan)
        raise AddonError("enough")

    monkeypatch.setattr(driver, "find", lambda: found)
    monkeypatch.setattr(install, "begin", begin)
    graphics_card.forget()
    with pytest.raises(RuntimeError, match="enough"):
        blender.ops.roigs.setup_engine(build=build, wheels=str(tmp_path))
    assert [plan.torch_index for plan in plans] == [index]
    graphics_card.forget()


def test_all_versions_of_blender_share_the_environments(
    blender: ModuleType, addon: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon import settings

    def shared(user: str) -> Path:
        monkeypatch.setattr(blender.utils, "resource_path", lambda kind: user)
        return settings.environments()[0]

    assert shared("/home/a/blender/4.3") == shared("/home/a/blender/5.2")
    assert shared("/home/a/blender/5.2") == Path("/home/a/blender/roigs/engine")
    assert shared("/apps/blender/portable") == Path("/apps/blender/portable/roigs/engine")


def test_the_page_has_every_setting(blender: ModuleType, addon: ModuleType) -> None:
    """Where the add-on is enabled, they are read from there; where it is not, as in tests, not."""
    from roigs_addon import settings
    from roigs_addon.ui.preferences import RoigsPreferences

    names = {field.name for field in fields(settings.Settings)}
    own = {"bl_idname", "advanced", "all_threads"}
    assert names == RoigsPreferences.__annotations__.keys() - own
