# SPDX-License-Identifier: GPL-3.0-or-later
"""How large the demo room is, and how high its table and sideboard are, in metres."""

HALF_X, HALF_Y, HEIGHT = 2.6, 2.2, 2.6
TABLE_TOP = 0.76
SIDEBOARD = {"centre": (0.35, -1.96), "top": 0.86}
