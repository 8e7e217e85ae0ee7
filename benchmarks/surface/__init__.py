"""Meshes of the demo's objects against the true ones: `python -m benchmarks.surface`."""
