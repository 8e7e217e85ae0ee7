"""Structure from motion: a folder of photos becomes a COLMAP project."""
