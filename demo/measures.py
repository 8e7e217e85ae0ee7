# SPDX-License-Identifier: GPL-3.0-or-later
"""Sizes of the demo room, and heights of its table and sideboard, in metres."""

HALF_X, HALF_Y, HEIGHT = 2.6, 2.2, 2.6
TABLE_TOP = 0.76
SIDEBOARD = {"centre": (0.35, -1.96), "top": 0.86}
