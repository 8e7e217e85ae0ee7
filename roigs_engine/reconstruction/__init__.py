"""Structure from motion: makes a COLMAP project from a folder of photos."""
