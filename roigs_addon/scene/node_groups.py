"""Groups of nodes that the add-on makes once for a .blend, and finds again."""

from __future__ import annotations

from typing import Any

import bpy

Socket = tuple[str, str, str]
"""Name, `INPUT` or `OUTPUT`, and kind without `NodeSocket`."""


def known_group(name: str, tree: str, sockets: tuple[Socket, ...]) -> Any | None:
    """The group that was made under a name; None: there is none.

    Who made a .blend may have given the name to another group, so it counts by what it is: Blender
    then numbers the name of ours.

    Args:
        name: of the group.
        tree: its type, such as `GeometryNodeTree`.
        sockets: that it was given.
    """
    wanted = sorted((each, way, f"NodeSocket{kind}") for each, way, kind in sockets)
    groups: Any = bpy.data.node_groups
    for group in groups:
        if group.bl_idname == tree and (group.name == name or group.name.startswith(f"{name}.")):
            items = list(group.interface.items_tree)
            if all(item.item_type == "SOCKET" for item in items):
                found = sorted((item.name, item.in_out, item.socket_type) for item in items)
                if found == wanted:
                    return group
    return None
