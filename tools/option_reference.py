"""Writes docs/options.md, the reference of all options, from their declarations.

    python -m tools.option_reference

A test fails if the page is not what this writes.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from roigs_engine.commands.table import COMMANDS
from roigs_engine.requests import groups
from roigs_engine.requests.declare import Option, Request, options_of
from roigs_engine.requests.values import Choice, Flag, Number

BAR = r"\|"  # in a table's cell
PAGE = Path(__file__).resolve().parents[1] / "docs" / "options.md"
HEAD = """\
# Options

This page lists all options of all commands. `python -m tools.option_reference` generates it from
their declarations. [Commands](commands.md) explains them. In an [options
file](files.md#options-file) and in a request in Python, use the keys of the second column. A key
without an option exists only there.
"""
SHARED: tuple[type[Request], ...] = (
    *(groups.Scene, groups.ObjectMasks, groups.Boxes, groups.Selection, groups.Training),
    *(groups.Layout, groups.Device),
)


def page() -> str:
    """The text of the page."""
    parts = [HEAD]
    for group in SHARED:
        parts += [f"## {_title(group)}", "", _used(group), "", *_table(options_of(group))]
    for name, command in COMMANDS.items():
        options = options_of(command.request)
        shared = {key for group in _shared(command.request) for key in options_of(group)}
        own = {key: value for key, value in options.items() if key not in shared}
        parts += [f"## {name}", "", f"`{name}`: {command.help}.", ""]
        found = ", ".join(_link(group) for group in _shared(command.request))
        parts += [f"Also the options of {found}.", ""] if found else []
        parts += _table(own) if own else []
    return "\n".join(parts).rstrip() + "\n"


def _shared(request: type[Request]) -> list[type[Request]]:
    return [group for group in SHARED if issubclass(request, group)]


def _title(group: type[Request]) -> str:
    return (group.heading or group.__name__.lower()).capitalize()


def _link(group: type[Request]) -> str:
    title = _title(group)
    return f"[{title.lower()}](#{title.lower().replace(',', '').replace(' ', '-')})"


def _used(group: type[Request]) -> str:
    names = [name for name, c in COMMANDS.items() if issubclass(c.request, group)]
    return f"For {', '.join(f'`{name}`' for name in names)}."


def _table(options: dict[str, Option]) -> Iterator[str]:
    yield "| option | key | values | what it does |"
    yield "|---|---|---|---|"
    for name, option in options.items():
        if option.hidden != "help":
            cells = (_flags(option), f"`{name}`", _values(option), option.text())
            yield f"| {' | '.join(cell.replace('|', BAR) for cell in cells)} |"
    yield ""


def _flags(option: Option) -> str:
    if option.hidden:
        return ""
    metavar = option.kind.metavar or option.name.upper()
    if not option.flags:
        return f"`{option.kind.metavar or option.name}`"
    taken = "" if isinstance(option.kind, (Flag, Choice)) else f" {metavar}"
    shown = [f"`{flag}{taken}`" for flag in option.flags]
    return ", ".join(shown) + (" (required)" if option.required else "")


def _values(option: Option) -> str:
    if isinstance(option.kind, Number):
        return str(option.kind)
    if isinstance(option.kind, Choice):
        return ", ".join(f"`{word}`" for word in option.kind.words)
    return "true or false" if isinstance(option.kind, Flag) else ""


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
