"""Reports on a reconstruction: registered photos, and reasons for unregistered ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..formats.projects import FEWEST_OBSERVED, weakly_observed
from ..formats.text import counted, markdown_text, named, printable
from .database import FEWEST_INLIERS, PANORAMIC, STILL, Pair
from .mapping import Mapped
from .photo_checks import Found, blurred, small, warnings_of

GROUP = 3  # photos; smaller unconnected groups do not count as a place
# Shares of the pairs. In real scenes with walls and tables, a plane explains up to 54 % of pairs.
ONE_PLACE, BEHIND = 0.9, 0.5
NOTHING = "No two photos could be registered: their matches are too few, or all are from one place."
FEW_FEATURES = 200
HIGH_ERROR = 1.5  # px
FEW_POINTS = 100  # observed by a photo
WEAK = 0.2  # of the registered photos: warns if more than this share have few points
SHARE = 0.9  # of the photos: warns if fewer than this share are registered


@dataclass(frozen=True, kw_only=True)
class Reconstruction:
    """The result of a reconstruction."""

    found: Found  # the photos, used and skipped
    features: Mapping[str, int]  # name -> number of features
    matched: Mapping[Pair, int]  # two names -> number of verified matches
    models: list[Mapped]  # largest first, which is the result; empty: no photos were registered
    seconds: Mapping[str, float]  # step -> wall-clock time
    warnings: Sequence[str] = ()  # on the matches, see `warnings_of_matches`

    @property
    def missing(self) -> list[str]:
        """Names of the photos that are not registered."""
        return [p.name for p in self.found.photos if p.name not in self.registered]

    @property
    def registered(self) -> Mapping[str, int]:
        """Registered photo -> number of points that it observes."""
        return self.models[0].photos if self.models else {}


def warnings_of_matches(
    names: Sequence[str], matched: Mapping[Pair, int], kinds: Mapping[int, int]
) -> list[str]:
    """Warnings from the matches, before photos are registered: sentences, usually none.

    `matched`, `kinds`: `database.matched_pairs` and `database.pair_kinds`.
    """
    found = []
    groups = [group for group in connected(names, matched) if len(group) >= GROUP]
    if len(groups) > 1:
        parts = "; ".join(f"{counted(len(group), 'photo')}: {named(group, 2)}" for group in groups)
        found.append(f"The photos show {len(groups)} unconnected places ({parts}).")
    total = sum(kinds.values())
    if total and sum(kinds.get(kind, 0) for kind in PANORAMIC) > ONE_PLACE * total:
        found.append(
            "Most photos were taken from one place, where depth cannot be seen."
            " Move the camera sideways between photos."
        )
    if total and sum(kinds.get(kind, 0) for kind in STILL) > BEHIND * total:
        found.append(
            "In most photos, the background stands still, as with a turntable. Mask the "
            "background (Masks, --masks), or move the camera instead."
        )
    return found


def connected(names: Sequence[str], matched: Mapping[Pair, int]) -> list[list[str]]:
    """Group photos that verified pairs connect; the largest group first."""
    leader = {name: name for name in names}

    def leading(name: str) -> str:
        while leader[name] != name:
            leader[name] = name = leader[leader[name]]
        return name

    for (one, other), matches in matched.items():
        if matches >= FEWEST_INLIERS and one in leader and other in leader:
            leader[leading(one)] = leading(other)
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(leading(name), []).append(name)
    return sorted(groups.values(), key=len, reverse=True)


def reason(result: Reconstruction, name: str) -> str:
    """The reason why a photo was not registered."""
    features = result.features.get(name, 0)
    if features == 0:
        return "no features: it shows nothing, or pycolmap cannot read it"
    if features < FEW_FEATURES:
        return f"few features ({features})"
    partners = {
        one if other == name else other: matches
        for (one, other), matches in result.matched.items()
        if name in (one, other) and matches >= FEWEST_INLIERS
    }
    if not partners:
        return "no photo matches it"
    for number, model in enumerate(result.models[1:], start=2):
        if name in model.photos:
            return f"in model {number}, which is not connected with the largest"
    known = {other for other in partners if other in result.registered}
    if not result.models:
        return f"matched with {counted(len(partners), 'photo')}, but their poses are unknown"
    if not known:
        return f"it matches only photos that were not registered ({named(sorted(partners), 2)})"
    best = max(known, key=lambda other: partners[other])
    return f"too few matches: {counted(len(known), 'photo')}, at best {partners[best]} with {best}"


def findings(result: Reconstruction) -> list[tuple[str, str]]:
    """Messages on the result: (level, sentence), with level 'info', or 'warning' if to be fixed."""
    best, total = result.models[0], len(result.found.photos)
    told = [("info", _summary(result))]
    missing = result.missing
    if missing:
        level = "warning" if len(best.photos) < SHARE * total else "info"
        why = f"{printable(missing[0])}: {reason(result, missing[0])}"
        told.append((level, f"{counted(len(missing), 'photo')} not registered. {why}."))
    if len(best.photos) == 2:
        told.append(("warning", "Only two photos could be registered. Take more, closer together."))
    others = [model for model in result.models[1:] if len(model.photos) > 2]
    for number, model in enumerate(others, start=2):
        text = f"{counted(len(model.photos), 'photo')} form a model of their own (model {number}):"
        told.append(("warning", f"{text} {named(sorted(model.photos))}."))
    told += [("warning", text) for text in _unreliable(result)]
    weak = sum(FEWEST_OBSERVED <= points < FEW_POINTS for points in best.photos.values())
    if weak:
        text = f"{counted(weak, 'photo')} with fewer than {FEW_POINTS} points: cameras may be off."
        told.append(("warning" if weak > WEAK * len(best.photos) else "info", text))
    if best.error > HIGH_ERROR:
        told.append(("warning", f"The reprojection error is high: {best.error:.1f} px."))
    return told


def _unreliable(result: Reconstruction) -> list[str]:
    """The sentence on photos registered by too few points, if there are any."""
    names = weakly_observed(result.registered)
    if not names:
        return []
    are = "has" if len(names) == 1 else "have"
    return [
        f"{counted(len(names), 'photo')} {are} fewer than {FEWEST_OBSERVED} points and may be"
        f" registered wrongly: {named(names)}. Leave them out (--exclude)."
    ]


def _summary(result: Reconstruction) -> str:
    if not result.models:
        return NOTHING
    best, total = result.models[0], len(result.found.photos)
    return (
        f"{len(best.photos)} of {counted(total, 'photo')} registered,"
        f" {counted(best.points, 'point')}, reprojection error {best.error:.2f} px."
    )


def as_markdown(result: Reconstruction) -> str:
    """The report as Markdown."""
    lines = ["# Reconstruction", "", markdown_text(_summary(result)), ""]
    remarks = [*warnings_of(result.found), *result.warnings]
    if result.models:
        told = [text for _, text in findings(result)[1:]]  # the last table has weak photos
        remarks += [text for text in told if text not in _unreliable(result)]
    lines += [f"- {markdown_text(text)}" for text in remarks]
    lines += ["", "| | |", "|---|---|"]
    lines += [f"| photos registered | {len(result.registered)} of {len(result.found.photos)} |"]
    if result.models:
        best, observed = result.models[0], list(result.registered.values())
        lines += [
            f"| points | {best.points} |",
            f"| mean reprojection error | {best.error:.3f} px |",
            f"| photos per point | {best.track:.1f} |",
            f"| points per photo | {int(np.median(observed))} (median), {min(observed)} (least) |",
            f"| models | {', '.join(str(len(model.photos)) for model in result.models)} photos |",
        ]
    lines += [f"| {step} | {seconds:.0f} s |" for step, seconds in result.seconds.items()]
    if result.missing:
        notes = dict.fromkeys(blurred(result.found.photos), "blurred; ")
        notes |= dict.fromkeys(small(result.found.photos), "small; ")
        lines += ["", "## Not registered", "", "| photo | why |", "|---|---|"]
        why = {name: f"{notes.get(name, '')}{reason(result, name)}" for name in result.missing}
        lines += [f"| {markdown_text(name)} | {markdown_text(why[name])} |" for name in why]
    few = {name: n for name, n in result.registered.items() if n < FEW_POINTS}
    if few:
        lines += ["", f"## Fewer than {FEW_POINTS} points", "", "| photo | points |", "|---|---|"]
        weakest = sorted(few, key=lambda name: few[name])
        lines += [f"| {markdown_text(name)} | {few[name]} |" for name in weakest]
    return "\n".join(lines) + "\n"
