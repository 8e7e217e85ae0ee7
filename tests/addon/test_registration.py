"""Registering and unregistering leave nothing behind."""

from __future__ import annotations

import sys
import types
from pathlib import Path
from types import ModuleType

import pytest

import roigs_addon


def below(cls: type) -> set[type]:
    """The subclasses of a class, and theirs."""
    direct = set(cls.__subclasses__())
    return direct.union(*map(below, direct))


def registered(bpy: ModuleType) -> dict[str, set[str]]:
    """Everything that an add-on can leave in Blender."""
    handlers = {
        f"{name}: {function.__module__}.{function.__qualname__}"
        for name in dir(bpy.app.handlers)
        if isinstance(functions := getattr(bpy.app.handlers, name), list)
        for function in functions
    }
    menus = {
        f"{name}: {function.__module__}.{function.__qualname__}"
        for name in dir(bpy.types)
        for function in getattr(getattr(getattr(bpy.types, name), "draw", None), "_draw_funcs", ())
        if not function.__module__.startswith("bl_ui.")  # the menu's own, listed after an append
    }
    subclasses = {
        cls.__name__
        for base in (bpy.types.Operator, bpy.types.Panel, bpy.types.PropertyGroup)
        for cls in below(base)
        if cls.is_registered
    }
    owners = ("Scene", "Object", "WindowManager", "Camera", "Collection", "Mesh")
    return {
        "types": set(dir(bpy.types)),
        "operators": set(dir(bpy.ops.roigs)),
        "handlers": handlers,
        "menus": menus,
        "subclasses": subclasses,
        "properties": {
            f"{o}.{p.identifier}" for o in owners for p in getattr(bpy.types, o).bl_rna.properties
        },
    }


@pytest.mark.blender
def test_nothing_stays(blender: ModuleType) -> None:
    before = registered(blender)
    inside = []
    for _ in range(2):
        roigs_addon.register()
        inside.append(registered(blender))
        assert blender.context.scene.roigs.preset == "draft"
        roigs_addon.unregister()
        assert registered(blender) == before
        assert not hasattr(blender.context.scene, "roigs")
    assert inside[0] == inside[1]
    assert inside[0]["operators"] > {"import_colmap", "add_roi", "select_cameras", "train_roi"}
    assert any("roigs_addon" in entry for entry in inside[0]["menus"])


@pytest.mark.blender
def test_no_operator_remembers_its_last_call(addon: ModuleType, blender: ModuleType) -> None:
    """Otherwise a button that leaves a property out repeats what another one did with it: Render
    would render an animation, Import Cameras the previous folder."""
    operators = [getattr(blender.ops.roigs, name) for name in dir(blender.ops.roigs)]
    kept = {
        f"{operator.idname_py()}.{item.identifier}"
        for operator in operators
        for item in operator.get_rna_type().properties
        if item.identifier != "rna_type" and not item.is_skip_save
    }
    assert len(operators) > 10 and not kept


@pytest.mark.blender
def test_no_timer_stays(addon: ModuleType, blender: ModuleType) -> None:
    from roigs_addon.jobs import current

    current.timer.start()
    assert current.timer.running
    current.unregister()
    assert not current.timer.running


def pure_modules() -> list[str]:
    """Everything in the rooms that need no Blender, and the files of others that need none."""
    found = ["errors", "worker", "viewport.packing", "viewport.sorting"]
    found += [f"jobs.{name}" for name in ("spec", "state", "job", "terminal")]
    for room in ("geometry", "formats", "engine"):
        folder = Path(roigs_addon.__path__[0]) / room
        found += [f"{room}.{path.stem}" for path in folder.glob("*.py") if path.stem != "__init__"]
    return [f"roigs_addon.{name}" for name in found]


def test_pure_files_need_no_blender() -> None:
    """`roigs_addon` itself imports nothing, so that these can be tested anywhere."""
    import subprocess

    code = "import sys; sys.modules['bpy'] = None\n"
    code += "\n".join(f"import {name}" for name in pure_modules())
    subprocess.run([sys.executable, "-c", code], check=True, cwd=roigs_addon.__path__[0] + "/..")


def test_a_failed_registration_is_taken_back(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []

    def part(name: str, fails: bool = False) -> str:
        def register() -> None:
            if fails:
                raise RuntimeError(name)
            calls.append(f"+{name}")

        module = types.ModuleType(f"roigs_addon.{name}")
        module.register, module.unregister = register, lambda: calls.append(f"-{name}")
        monkeypatch.setitem(sys.modules, module.__name__, module)
        return name

    monkeypatch.setattr(roigs_addon, "MODULES", (part("a"), part("b")))
    roigs_addon.register()
    roigs_addon.unregister()
    assert calls == ["+a", "+b", "-b", "-a"]
    calls.clear()
    monkeypatch.setattr(roigs_addon, "MODULES", (part("a"), part("b"), part("c", fails=True)))
    with pytest.raises(RuntimeError, match="c"):
        roigs_addon.register()
    assert calls == ["+a", "+b", "-b", "-a"]


def test_the_methods_are_the_engines(addon: ModuleType) -> None:
    from roigs_engine.requests import choices
    from roigs_engine.selection import METHODS

    assert set(choices.METHODS) == set(METHODS)
