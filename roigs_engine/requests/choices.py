"""Words that options choose from, and limits of their numbers."""

from __future__ import annotations

METHODS = ("static", "gp6", "gp9", "greedy", "coverage", "fvs", "random")
"""Methods that select photos."""
PRESETS = ("draft", "paper", "standard")
STRATEGIES = ("joint", "independent")
INITS = ("scene", "points", "box")
ORDERS = ("ordered", "shuffled")
TEST, VALIDATION = PHOTOS = ("test", "validation")
BASELINES = ("full-scene", "full-object", "full-scene-tuned", "full-object-tuned")
COMPARISONS = (*BASELINES, *STRATEGIES)
DEVICES = ("auto", "cpu", "cuda")
AXES = ("-y", "y", "z")
"""Axes that may point up in a file of Gaussians."""
PAIRS = ("auto", "all", "similar", "ordered")
CAMERAS = ("auto", "one", "each")
CAMERA_MODELS = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")

MAX_SEED = (1 << 32) - 1  # what numpy takes
MAX_SIDE = 1 << 20  # pixels; a larger camera means a damaged file
MAX_DOWNSCALE = 1_000_000
MAX_FACTOR = 1000  # of the steps: a larger one is a typing error
MOST_BLOCKS = 64
MIN_VIEWS = 4
"""Photos that must show what is before the boxes; else it is a floater."""
