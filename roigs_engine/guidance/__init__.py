"""Measures how well photos cover a box; suggests the next photo (docs/method.md, "Guidance")."""
