"""Reads a COLMAP project as a scene; inspects and exports it."""
