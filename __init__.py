"""Entry of the Blender extension: Blender imports this folder as a package and calls these two."""

from .roigs_addon import register, unregister

__all__ = ["register", "unregister"]
