"""Gain of the guide's photos, with truth: the demo's script renders any photo."""
