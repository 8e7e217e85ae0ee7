"""Finds the node groups that the add-on makes once for a .blend."""

from __future__ import annotations

from typing import Any

import bpy

from ..blender import is_local

Socket = tuple[str, str, str]
"""Name, `INPUT` or `OUTPUT`, and kind without `NodeSocket`."""


def known_group(name: str, tree: str, sockets: tuple[Socket, ...]) -> Any | None:
    """Return the group that was made under a name; None if there is none.

    In a user's .blend, another group may have the name, and Blender then numbers ours. So type and
    sockets decide. A linked group is left out, because its .blend may go.

    Args:
        name: of the group.
        tree: its type, such as `GeometryNodeTree`.
        sockets: those that it was given.
    """
    wanted = sorted((each, way, f"NodeSocket{kind}") for each, way, kind in sockets)
    groups: Any = bpy.data.node_groups
    for group in filter(is_local, groups):
        if group.bl_idname == tree and (group.name == name or group.name.startswith(f"{name}.")):
            items = list(group.interface.items_tree)
            if all(item.item_type == "SOCKET" for item in items):
                found = sorted((item.name, item.in_out, item.socket_type) for item in items)
                if found == wanted:
                    return group
    return None
