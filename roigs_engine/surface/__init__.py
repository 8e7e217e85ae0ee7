"""Meshes of boxed objects, with texture from the photos."""
