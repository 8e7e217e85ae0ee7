"""PSNR against training seconds, as SVG."""

from __future__ import annotations

import html
from collections.abc import Sequence

from ..formats.text import printable
from .scores import ModelScore

WIDTH, HEIGHT = 640, 280
LEFT, RIGHT, TOP, BOTTOM = 60, 180, 20, 45  # margins; names stand in the right one
MARGIN = 0.08  # of the range of PSNR, above and below


def plot(rows: Sequence[ModelScore]) -> list[str]:
    """Lines of SVG with a point for each model; nothing if fewer than two have both numbers."""
    points = [
        (row.model, row.seconds, row.roi_psnr)
        for row in rows
        if row.seconds > 0 and row.roi_psnr is not None
    ]
    if len(points) < 2:
        return []
    low, high = min(p for *_, p in points), max(p for *_, p in points)
    room = MARGIN * (high - low) or 0.5
    low, high, longest = low - room, high + room, max(seconds for _, seconds, _ in points)
    wide, tall = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM
    bottom = TOP + tall
    lines = [
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" role="img"'
        ' aria-label="ROI PSNR against training seconds">',
        f'<path d="M{LEFT} {TOP}V{bottom}H{LEFT + wide}" fill="none" stroke="currentColor"/>',
        f'<text x="{LEFT}" y="{HEIGHT - 8}">training time (seconds)</text>',
        f'<text x="{LEFT + wide}" y="{bottom + 18}" text-anchor="end">{longest:,.0f}</text>',
        f'<text x="{LEFT}" y="{bottom + 18}">0</text>',
        f'<text x="{LEFT - 6}" y="{TOP + 10}" text-anchor="end">{high:.1f} dB</text>',
        f'<text x="{LEFT - 6}" y="{bottom}" text-anchor="end">{low:.1f}</text>',
    ]
    for name, seconds, psnr in points:
        x = LEFT + wide * seconds / longest
        y = TOP + tall * (high - psnr) / (high - low)
        label = html.escape(printable(name))
        lines.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5" fill="#ffa000"/>')
        lines.append(f'<text x="{x + 9:.1f}" y="{y + 4:.1f}">{label}</text>')
    return [*lines, "</svg>"]
