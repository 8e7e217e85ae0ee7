"""Answers: what each command prints on standard output, of its request and its result."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from ..formats.text import counted, in_gb
from ..requests.declare import Request

if TYPE_CHECKING:
    from ..app.batch import Batched, NewTable, PlannedBatch
    from ..app.convert import Converted
    from ..app.evaluate import Evaluated
    from ..app.objects import Composed, FoundFloaters
    from ..app.outputs import Planned, Result, Trained
    from ..app.render import Rendered
    from ..app.scenes import Exported, Inspected, Reconstructed, Refined, Selected
    from ..app.upkeep import Cleaned, Levelled
    from ..colmap.refine import Refinement
    from ..colmap.refine_by_matches import MatchedFit
    from ..formats.levels import Ladder
    from ..requests import models, projects


def _places(outputs: dict[str, str]) -> str:
    """Where a command has written what."""
    return "\n".join(f"{what + ':':10}{path}" for what, path in outputs.items())


def all_places(_: Request, result: Result) -> str:
    return _places(result.outputs)


def nothing(_: Request, __: Result) -> str:
    return ""


def reconstructed(_: Request, result: Reconstructed) -> str:
    return _places(result.outputs | {"model": str(result.model)})


def inspected(request: projects.Inspect, result: Inspected) -> str:
    from ..colmap.inspect import format_inspection

    return json.dumps(result.report, indent=1) if request.json else format_inspection(result.report)


def exported(request: projects.Export, result: Exported) -> str:
    cameras, points = counted(result.cameras, "camera"), counted(result.points, "point")
    return f"{cameras} and {points} in {request.out}"


def refined(_: Request, result: Refined) -> str:
    said = described(result.refinement)
    if result.model is None:
        return said
    where = f"The new model is in {result.model}. Use this folder as the scene; boxes stay as they"
    return f"{said}\n{where} are."


def described(done: Refinement) -> str:
    """What the refinement of cameras did, in a few sentences."""
    return " ".join([_by_tracks(done), *_by_matches(done.matched)])


def _by_tracks(done: Refinement) -> str:
    count = counted(done.left_out, "observation")
    errors = f"{done.before:.2f} -> {done.after:.2f} px, median of {count} left out"
    if not done.fits_tracks_better:
        nothing = "" if done.better else " Nothing is written."
        return f"The cameras cannot be made to fit the tracks better ({errors}).{nothing}"
    fuller = f" {counted(done.cameras, 'camera')} got OPENCV's parameters." if done.cameras else ""
    return f"The cameras fit better: {errors}.{fuller}"


def _by_matches(fit: MatchedFit | None) -> list[str]:
    if fit is None:
        return []
    if not fit.enough:
        return [f"Only {counted(fit.matches, 'place')} matched in the photos: they were not used."]
    matched = f"{counted(fit.matches, 'place')} matched in {counted(fit.photos, 'photo')}"
    if not fit.better:
        return [f"With {matched}, they fit as well as they can ({fit.after:.3f} px)."]
    errors = f"{fit.before:.3f} -> {fit.after:.3f} px, median of {fit.left_out:,} left out"
    changed = " and ".join([", ".join(fit.changed[:-1]), fit.changed[-1]]).removeprefix(" and ")
    return [f"With {matched}: {errors} ({changed} changed)."]


def selected(request: projects.Select, result: Selected) -> str:
    from ..selection import format_selection

    said = [format_selection(selection) for selection in result.selections]
    if result.files:
        said.append(f"{counted(len(result.files), 'list')} of photos in {request.out}")
    return "\n".join(said)


def trained(_: Request, result: Trained | Planned) -> str:
    from ..app.outputs import Planned

    if isinstance(result, Planned):
        return result.text
    return f"{result.table}\n{_places(result.outputs)}" if result.table else ""


def evaluated(_: Request, result: Evaluated) -> str:
    return f"{result.table}\n{_places(result.outputs)}"


def composed(_: Request, result: Composed) -> str:
    return f"{counted(result.count, 'Gaussian')} in {result.result}"


def converted(request: models.Convert, result: Converted) -> str:
    said = counted(result.count, "Gaussian")
    if request.out.name == "lod-meta.json":
        return f"{said} in levels of detail in {request.out.parent}"
    left = f" ({result.left_out:,} left out)" if result.left_out > 0 else ""
    return f"{said}{left}, {request.out.stat().st_size / 1e6:.1f} MB in {request.out}"


def floaters(_: Request, result: FoundFloaters) -> str:
    return f"{counted(result.count, 'floater')} among {result.among:,} Gaussians"


def levels(_: Request, result: Levelled) -> str:
    return "\n".join([*_rows(result.ladders), _places(result.outputs)])


def _rows(ladders: tuple[Ladder, ...]) -> list[str]:
    """The levels as a table."""
    rows = [
        "| part | Gaussians | from | PSNR | whole, drawn so small |",
        "|---|---:|---:|---:|---:|",
    ]
    for ladder in ladders:
        for level in ladder.levels:
            name = ladder.box or "surroundings"
            if not level.farther:
                rows.append(f"| {name} | {level.gaussians:,} | | | |")
                continue
            psnr, whole = (level.measured[key] for key in ("psnr", "psnr_whole"))
            rows.append(
                f"| {name} | {level.gaussians:,} | {level.farther:.1f} x the distance"
                f" | {psnr:.1f} | {whole:.1f} |"
            )
    return rows


def rendered(_: Request, result: Rendered) -> str:
    return f"{counted(result.count, 'picture')} in {result.pictures}"


def batched(_: Request, result: Batched | NewTable | PlannedBatch) -> str:
    from ..app.batch import Batched, PlannedBatch

    if isinstance(result, PlannedBatch):
        return result.text
    if isinstance(result, Batched):
        failed = [f"failed: {reason}" for reason in result.failed]
        return "\n".join([*failed, _places(result.outputs)])
    return ""


def cleaned(_: Request, result: Cleaned) -> str:
    return "\n".join(f"{in_gb(size):>8}  {place}" for place, size in result.removable)
