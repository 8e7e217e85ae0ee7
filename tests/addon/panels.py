"""Draws panels without a window."""

from __future__ import annotations

from types import ModuleType


def stand_in(cls: type):
    """An object with a panel's methods; without a window Blender makes no panels."""
    methods = {
        name: value
        for c in cls.__mro__
        for name, value in vars(c).items()
        if callable(value) and not name.startswith("__")
    }
    return type("Stand-in", (), methods)()


class Layout:
    """A layout that accepts everything, and keeps the labels, also those of buttons and bars."""

    def __init__(self, labels: list[str]) -> None:
        vars(self)["labels"] = labels

    def __getattr__(self, name: str):
        def take(*args: object, **keywords: object) -> Layout:
            if name in ("label", "operator", "progress"):
                self.labels.append(str(keywords.get("text", "")))
            return Layout(self.labels)

        return take

    def __setattr__(self, name: str, value: object) -> None:
        pass


def said(bpy: ModuleType, cls: type) -> list[str]:
    """The labels of a panel."""
    panel = stand_in(cls)
    panel.layout = Layout([])
    panel.draw(bpy.context)
    return panel.layout.labels
