"""Writes suggested photos as a page for a phone or a printer: a plan, pictures and words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..formats.gravity import rotation_between
from ..formats.web_page import html_text, picture, whole_page
from ..model.roi import convex_hull
from ..model.scene import Float64
from .known import KnownBox
from .suggest import Suggestion
from .words import Units

SIDE, MARGIN = 600, 30  # of the plan, pixels
CLEAR = """\
.shots { display: grid; grid-template-columns: repeat(auto-fill, minmax(260px, 1fr)); gap: 1em; }
.shot { border: 1px solid #8886; border-radius: 6px; padding: .6em; break-inside: avoid; }
.shot img { display: block; width: 100%; height: auto; }
.shot h3 { margin: .2em 0; } .shot p { margin: .4em 0; overflow-wrap: anywhere; }
.number { display: inline-block; min-width: 1.6em; text-align: center; border-radius: 1em;
  background: #ffa000; color: #000; }
svg .photo { fill: #888; } svg .looks { stroke: #888; stroke-opacity: .5; }
svg .box { fill: #56b4e944; stroke: #0072b2; stroke-width: 2; }
svg .line { stroke: #ffa000; stroke-width: 1.5; } svg .shot-at { fill: #ffa000; stroke: none; }
svg .n { fill: #000; font-weight: bold; }
@media print { body { max-width: none; padding: 0; font-size: 12px; }
  .shots { grid-template-columns: repeat(4, 1fr); } section { break-after: page; }
  svg { max-height: 11cm; } }"""


@dataclass(frozen=True, kw_only=True, eq=False)
class Shots:
    """The suggestions for a box, with the words and the picture (JPEG) of each."""

    known: KnownBox
    shots: Sequence[Suggestion]
    words: Sequence[str]
    pictures: Sequence[bytes]


def suggestions_page(boxes: Sequence[Shots], units: Units) -> str:
    """The page; it uses no network, and all names are escaped."""
    names = ", ".join(f"'{box.known.map.roi.name}'" for box in boxes)
    parts = [part for box in boxes for part in _box(box, units)]
    return whole_page(f"Next photos of {names}", parts, style=f"\n{CLEAR}")


def _box(box: Shots, units: Units) -> Iterator[str]:
    found = box.known.map
    name = html_text(found.roi.name)
    yield f"<section><h2>{name}</h2>"
    after = box.shots[-1].value if box.shots else found.value
    yield (
        f"<p>Known now: {found.value:.0%} of its surface and directions, from"
        f" {len(found.images)} photos. With these {len(box.shots)}: {after:.0%}. The best are"
        " first; each number is by how much the error is expected to fall.</p>"
    )
    yield from _plan(box, units)
    yield '<div class="shots">'
    for number, (shot, words, jpeg) in enumerate(
        zip(box.shots, box.words, box.pictures, strict=True), start=1
    ):
        yield (
            f'<div class="shot"><h3><span class="number">{number}</span>'
            f" +{shot.gain:.2f} dB</h3>"
            f"{picture(jpeg, 'jpeg', f'What photo {number} should show')}"
            f"<p>{html_text(words)}</p></div>"
        )
    yield "</div></section>"


def _plan(box: Shots, units: Units) -> Iterator[str]:
    """The view from above as SVG: photos, box, suggested places."""
    found, up = box.known.map, box.known.places.up
    flat = rotation_between(up, np.array([0.0, 0.0, 1.0]))[:2]
    photos = np.array([image.centre for image in found.images]) @ flat.T
    looks = np.array([image.forward for image in found.images]) @ flat.T
    shots = np.array([shot.centre for shot in box.shots]).reshape(-1, 3) @ flat.T
    corners = convex_hull(found.roi.corners() @ flat.T)
    middle = flat @ found.roi.centre
    # Far photos would make near ones unreadable, so they are drawn at the edge.
    reach = np.linalg.norm(np.concatenate([photos, shots, corners]) - middle, axis=1)
    reach_of_shots = np.linalg.norm(np.concatenate([shots, corners]) - middle, axis=1).max()
    span = float(min(reach.max(), 2 * reach_of_shots)) or 1.0
    scale = (SIDE / 2 - MARGIN) / span

    def at(place: Float64) -> tuple[float, float]:
        x, y = np.clip((place - middle) * scale, MARGIN - SIDE / 2, SIDE / 2 - MARGIN)
        return SIDE / 2 + float(x), SIDE / 2 - float(y)

    yield (
        f'<svg viewBox="0 0 {SIDE} {SIDE}" width="{SIDE}" role="img"'
        ' aria-label="Plan from above: photos grey, suggested places numbered">'
    )
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(at, corners))
    yield f'<polygon class="box" points="{path}"/>'
    for photo, look in zip(photos, looks, strict=True):
        (x, y), way = at(photo), look / max(float(np.linalg.norm(look)), 1e-9)
        ahead = f"M{x:.1f} {y:.1f}l{14 * way[0]:.1f} {-14 * way[1]:.1f}"
        yield f'<path class="looks" d="{ahead}"/>'
        yield f'<circle class="photo" cx="{x:.1f}" cy="{y:.1f}" r="3"/>'
    for shot in shots:
        (x, y), (mx, my) = at(shot), at(middle)
        yield f'<path class="line" d="M{x:.1f} {y:.1f}L{mx:.1f} {my:.1f}"/>'
    for number, shot in enumerate(shots, start=1):
        x, y = at(shot)
        yield f'<circle class="shot-at" cx="{x:.1f}" cy="{y:.1f}" r="11"/>'
        yield f'<text class="n" x="{x:.1f}" y="{y + 4.5:.1f}" text-anchor="middle">{number}</text>'
    yield from _scale_bar(span, scale, units)
    yield "</svg>"
    yield "<p>Plan from above. Grey: photos that are there, and where they look. Blue: the box.</p>"


def _scale_bar(span: float, scale: float, units: Units) -> Iterator[str]:
    """A scale bar with a round length, about a third of the plan."""
    unit = units.scale or 1.0
    wish = span * unit / 1.5
    power = 10 ** np.floor(np.log10(wish))
    length = float(max(step for step in (1, 2, 5) if step * power <= wish) * power) / unit
    y = SIDE - 8
    yield f'<path d="M{MARGIN} {y}h{length * scale:.1f}" stroke="currentColor" stroke-width="2"/>'
    yield f'<text x="{MARGIN}" y="{y - 6}">{html_text(units.length(length))}</text>'
