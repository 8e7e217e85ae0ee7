"""COLMAP projects: read as scenes, inspected, exported; cameras refined."""
