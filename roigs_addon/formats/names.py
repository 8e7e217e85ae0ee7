"""Which names of boxes can name files. No bpy."""

from __future__ import annotations

FORBIDDEN = '/\\:*?"<>|\0'


def can_name_a_file(name: str) -> bool:
    """Whether a file of this name can be written on every system, in the folder it is meant for."""
    return bool(name.strip(" .")) and not any(letter in FORBIDDEN for letter in name)
