"""Choices of options, with their names in Blender, and limits of numbers."""

from __future__ import annotations

from ..formats.targets import TARGETS

METHOD_ITEMS = (
    (
        "coverage",
        "Coverage",
        "Photos that cover the box from all sides, as large as possible",
    ),
    ("gp9", "Gaussian process (paper)", "A Gaussian process over nine view parameters"),
    ("gp6", "Gaussian process, 6", "A Gaussian process over six view parameters"),
    ("greedy", "Greedy", "In each round, the photo with the largest gain in score"),
    ("static", "Static", "Photos ranked once, by distance, size and points"),
    ("fvs", "Farthest views", "Viewpoints as far apart as possible"),
    ("random", "Random", "Random photos, for comparison"),
)
"""Methods for selecting photos: word, name, description."""
METHODS = tuple(word for word, _, _ in METHOD_ITEMS)
PRESETS = ("draft", "paper", "standard")
STRATEGY_ITEMS = (
    ("joint", "All boxes together", "One stage refines all boxes within the whole scene"),
    (
        "independent",
        "One by one (paper)",
        "A model for each box, which then replaces the coarse one",
    ),
)
STRATEGIES = tuple(word for word, _, _ in STRATEGY_ITEMS)
MADE_FOR_ITEMS = tuple((t.name, t.title, t.help) for t in TARGETS.values())
MADE_FOR = tuple(TARGETS)
INITS = ("scene", "points", "box")
ORDERS = ("ordered", "shuffled")
TEST, VALIDATION = PHOTOS = ("test", "validation")
BASELINES = ("full-scene", "full-object", "full-scene-tuned", "full-object-tuned")
COMPARISONS = (*BASELINES, *STRATEGIES)
DEVICES = ("auto", "cpu", "cuda", "gpu")
AXES = ("-y", "y", "z")
"""Possible up axes of a file of Gaussians."""
PAIR_ITEMS = (
    ("auto", "Auto", "All pairs if there are few photos, otherwise the most similar ones"),
    ("all", "All", "Every pair: slow with many photos"),
    ("similar", "Similar", "Each photo with the most similar ones"),
    ("ordered", "Ordered", "Photos in the order of their names: each with its neighbours"),
)
CAMERA_ITEMS = (
    ("auto", "Auto", "Photos of one device, lens, focal length and size share a camera"),
    ("one", "One", "All photos of one size share a camera"),
    ("each", "Each", "Each photo has its own camera"),
)
PAIRS, CAMERAS = (tuple(item[0] for item in items) for items in (PAIR_ITEMS, CAMERA_ITEMS))
CAMERA_MODELS = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")

MOST_STEPS = 1_000_000  # of a single stage
MAX_SEED = (1 << 32) - 1  # numpy's limit
MAX_SIDE = 1 << 20  # pixels; a larger camera comes from a damaged file
MAX_DOWNSCALE = 1_000_000
MAX_FACTOR = 1000  # of the steps; a larger one is a typing error
MOST_BLOCKS = 64
MIN_VIEWS = 4
"""Fewest photos that show a Gaussian in front of the boxes; with fewer, it is a floater."""
