"""The certificate of an object: its size, and the resolution and directions of its photos."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ..formats.gravity import rotation_between
from ..formats.text import counted, printable
from ..formats.web_page import html_text, whole_page
from ..model.scene import Float64
from .box_map import SPACING, BoxMap, ways_to
from .figures import pixel_lengths
from .known import KnownBox
from .words import Units

SIDE = 320  # of the picture of directions, pixels
NAMED = 120  # photos named on the page
# Viridis, which colour-blind people can read, too; dark is low.
COLOURS = ("#440154", "#3b528b", "#21918c", "#5ec962", "#fde725")
SCORES = (
    ("object_psnr", "PSNR of the object", "{:.2f} dB"),
    ("roi_psnr", "PSNR in the box", "{:.2f} dB"),
    ("near_psnr", "PSNR in the box, near third", "{:.2f} dB"),
    ("far_psnr", "PSNR in the box, far third", "{:.2f} dB"),
    ("roi_ssim", "SSIM in the box", "{:.3f}"),
    ("roi_flip", "FLIP in the box (0 is best)", "{:.3f}"),
)
CLEAR = """\
@page { size: A4; margin: 14mm; }
.facts { display: flex; flex-wrap: wrap; gap: 1.5em; align-items: flex-start; }
td { white-space: normal; } td:first-child { color: GrayText; } td + td { text-align: left; }
.small { font-size: .8em; overflow-wrap: anywhere; }
@media print { body { max-width: none; padding: 0; font-size: 10px; } h1 { margin: 0 0 .4em; }
  .facts { flex-wrap: nowrap; } td { padding: .15em .5em; } svg { width: 230px; } }"""


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """The certified facts about an object; lengths in world units.

    Attributes:
        box: the box's name.
        size: extent of its points along the box's axes.
        metres: metres per unit; None: unknown.
        pixel_median, pixel_largest: length of a pixel on the surface, in the photo that shows each
            patch best: the median and the largest, over the patches in any photo.
        unseen: share of the reachable surface that no photo shows, 0 to 1.
        covered: share of patches and directions, by their weight, with a photo that sees the patch
            from within `SPACING` of the direction, 0 to 1.
        known: mean coverage (`BoxMap.known`) over patches and directions, 0 to 1.
        worst: the direction with the lowest coverage, in words.
        directions: (x, y, known) of each direction in a disc: up in the middle, straight below at
            the rim; known is None where no camera can be.
        photos: names of the photos that show the object.
        photos_digest: SHA-256 over their names and the hashes of their files.
        scores: held-out scores by their name in report.json; empty: there are none.
        facts: more lines, name -> text: software, settings, dates, hashes.
    """

    box: str
    size: tuple[float, float, float]
    metres: float | None
    pixel_median: float
    pixel_largest: float
    unseen: float
    covered: float
    known: float
    worst: str
    directions: tuple[tuple[float, float, float | None], ...]
    photos: tuple[str, ...]
    photos_digest: str
    scores: Mapping[str, float]
    facts: Mapping[str, str]

    def to_dict(self) -> dict[str, Any]:
        """The certificate as JSON values."""
        return asdict(self)

    @property
    def text(self) -> str:
        """One line for users."""
        units = Units(scale=self.metres)
        sides = " x ".join(units.length(side) for side in self.size)
        psnr = self.scores.get("object_psnr")
        held = f", {psnr:.2f} dB on test photos" if psnr is not None else ""
        return printable(
            f"'{self.box}': {sides}, {_pixel(self.pixel_median, units)} (median),"
            f" {self.covered:.0%} of the directions covered by"
            f" {counted(len(self.photos), 'photo')}{held}; worst {self.worst}."
        )


def certificate(
    known: KnownBox,
    units: Units,
    scores: Mapping[str, float],
    facts: Mapping[str, str],
) -> Certificate:
    """Make the certificate of a box from its map, scores and other facts."""
    found = known.map
    real = found.patches.places[~found.patches.guessed]
    local = real @ found.roi.world_to_box[:3, :3].T
    size = np.ptp(local, axis=0)
    pixels = pixel_lengths(found)
    reachable = found.weights.sum(axis=1) > 0
    seen = np.isfinite(pixels)
    digest = hashlib.sha256()
    for image in found.images:
        digest.update(f"{image.name} {image.file_digest or image.digest}\n".encode())
    return Certificate(
        box=found.roi.name,
        size=(float(size[0]), float(size[1]), float(size[2])),
        metres=units.scale,
        pixel_median=float(np.median(pixels[seen])) if seen.any() else float("inf"),
        pixel_largest=float(pixels[seen].max()) if seen.any() else float("inf"),
        unseen=float((reachable & ~seen).sum() / max(1, reachable.sum())),
        covered=_covered(found),
        known=found.value,
        worst=_worst(found, known.places.up),
        directions=_disc(found, known.places.up),
        photos=tuple(image.name for image in found.images),
        photos_digest=digest.hexdigest(),
        scores=dict(scores),
        facts=dict(facts),
    )


def _covered(found: BoxMap) -> float:
    """The share of patches and directions with a photo from a near direction."""
    near = np.zeros(found.weights.shape, dtype=bool)
    for column, image in enumerate(found.images):
        ways = ways_to(image.centre, found.patches.places)
        rows = np.flatnonzero(found.seen[:, column])
        near[rows] |= ways[rows] @ found.directions.T >= np.cos(SPACING)
    return float(found.weights[near].sum())


def _angles(directions: Float64, up: Float64) -> tuple[Float64, Float64]:
    """(B,) elevation and azimuth in radians; the azimuth is as in plans from above."""
    local = directions @ rotation_between(up, np.array([0.0, 0.0, 1.0])).T
    return np.arcsin(local[:, 2].clip(-1, 1)), np.arctan2(local[:, 1], local[:, 0])


def _disc(found: BoxMap, up: Float64) -> tuple[tuple[float, float, float | None], ...]:
    """Map the directions to a disc of radius 1, preserving areas."""
    rise, turn = _angles(found.directions, up)
    reach = np.sqrt((1 - np.sin(rise)) / 2)
    weight, value = found.of_directions()
    return tuple(
        (float(r * np.cos(t)), float(r * np.sin(t)), float(v) if w > 0 else None)
        for r, t, v, w in zip(reach, turn, value, weight, strict=True)
    )


def _worst(found: BoxMap, up: Float64) -> str:
    """The direction with the lowest coverage, described by the photo from the nearest direction."""
    weight, value = found.of_directions()
    row = int(np.argmin(np.where(weight > 0, value, np.inf)))
    way = found.directions[row]
    eyes = np.array([image.centre for image in found.images]) - found.roi.centre
    eyes /= np.maximum(np.linalg.norm(eyes, axis=1), 1e-300)[:, None]
    near = int(np.argmax(eyes @ way))
    angle = np.degrees(np.arccos(np.clip(eyes[near] @ way, -1, 1)))
    rise = np.degrees(_angles(way[None], up)[0][0])
    side = f"{abs(rise):.0f}° {'above' if rise >= 0 else 'below'} the horizon"
    name = found.images[near].name
    return f"from {side}, {angle:.0f}° from photo {name} ({value[row]:.0%} known)"


def _pixel(length: float, units: Units) -> str:
    if units.scale is None:
        return f"{length:.2g} units per pixel"
    return f"{1000 * length * units.scale:.2g} mm per pixel"


# --- page ---


def certificate_page(made: Certificate) -> str:
    """A page for one sheet of A4; it uses no network."""
    return whole_page(f"Certificate of '{made.box}'", _parts(made), style=f"\n{CLEAR}")


def section(made: Certificate) -> Iterator[str]:
    """The certificate as a section of a larger report: parts in HTML, below a heading."""
    yield f"<h3>{html_text(made.box)}</h3>"
    yield from _parts(made)


def _parts(made: Certificate) -> Iterator[str]:
    units = Units(scale=made.metres)
    rows = {
        "Size": " x ".join(units.length(side) for side in made.size),
        "A pixel on the surface, median": _pixel(made.pixel_median, units),
        "largest": _pixel(made.pixel_largest, units),
        "Unseen surface": f"{made.unseen:.0%}",
        "Directions with a photo within 18°": f"{made.covered:.0%}",
        "Coverage of surface and directions": f"{made.known:.0%}",
        "Worst direction": made.worst,
        "Photos that show it": str(len(made.photos)),
    }
    for key, title, form in SCORES:
        if key in made.scores:
            rows[title] = form.format(made.scores[key])
    yield '<div class="facts"><table>'
    yield from _rows(rows)
    yield "</table><div>"
    yield from _picture(made)
    yield "</div></div>"
    facts = {**made.facts, "SHA-256 of the photos": made.photos_digest}
    yield '<table class="small">'
    yield from _rows(facts)
    yield "</table>"
    rest = len(made.photos) - NAMED
    more = f" and {rest} more, in certificates.json" if rest > 0 else ""
    yield f'<p class="small">Photos: {html_text(", ".join(made.photos[:NAMED]) + more)}</p>'


def _rows(rows: Mapping[str, str]) -> Iterator[str]:
    for name, value in rows.items():
        yield f"<tr><td>{html_text(name)}</td><td>{html_text(value)}</td></tr>"


def _picture(made: Certificate) -> Iterator[str]:
    """Draw the directions as dots in a disc: dark ones are gaps, empty ones are unreachable."""
    half = SIDE / 2
    yield (
        f'<svg viewBox="0 0 {SIDE} {SIDE + 20}" width="{SIDE}" role="img" aria-label="Directions">'
    )
    for radius in (1.0, np.sqrt(0.5)):  # straight down, and the horizon
        shown = radius * (half - 10)
        yield f'<circle cx="{half}" cy="{half}" r="{shown:.1f}" fill="none" stroke="#888"/>'
    for x, y, known in made.directions:
        place = f'cx="{half + x * (half - 10):.1f}" cy="{half - y * (half - 10):.1f}"'
        if known is None:
            yield f'<circle {place} r="2" fill="none" stroke="#888"/>'
            continue
        step = min(int(known * len(COLOURS)), len(COLOURS) - 1)
        yield f'<circle {place} r="8" fill="{COLOURS[step]}" stroke="#888" stroke-width=".5"/>'
    for step, colour in enumerate(COLOURS):
        place = f'x="{half - 60 + 24 * step}" y="{SIDE}"'
        yield f'<rect {place} width="24" height="8" fill="{colour}"/>'
    yield f'<text x="{half - 66}" y="{SIDE + 9}" text-anchor="end">0 %</text>'
    yield f'<text x="{half + 66}" y="{SIDE + 9}">100 % covered</text></svg>'
    yield (
        '<p class="small">Directions from which the object is looked at: from above in the middle,'
        " level at the inner circle, from below at the rim; as in a plan from above.</p>"
    )
