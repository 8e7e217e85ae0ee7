"""The plan of a run as text: stages, photos, steps, memory, disk and minutes."""

from __future__ import annotations

from collections.abc import Sequence

from ..colmap.undistort import missing_in
from ..context import QUIET, Context
from ..formats.lock import holder
from ..formats.run_files import CACHE, LOCK, MANIFEST
from ..formats.text import counted, in_columns, in_gb
from .definition import Run
from .forecast import StageForecast, disk_space, forecast
from .layout import Cell
from .manifest import check_version, from_json, manifest_difference, read_manifest
from .memory import cell_memory
from .plan import Plan
from .strategies import plan_run

HEAD = ("stage", "photos", "size", "steps", "starts from", "Gaussians", "minutes", "")
LEFT = (0, 4, 7)  # left-aligned columns of text
MOST_NAMES = 3  # names of stages in a cell of the table


def describe_plan(
    run: Run, compare: Sequence[str] = (), context: Context = QUIET, *, update: bool = False
) -> str:
    """Describe the plan of a run; trains a few steps to measure their time, writes nothing.

    Args:
        run, compare, context: see `strategies.plan_run`.
        update: whether the run may move results of other settings aside.

    Raises:
        As `plan_run`; SceneError: the scene does not fit into the machine's memory;
        RunFolderError: another version made the folder.
    """
    check_version(run.folder)
    memory = run.memory(context)
    plan = plan_run(run, compare, context)
    expected = forecast(run, plan, context)
    table = in_columns([HEAD, *map(_row, expected.stages)], LEFT)
    lines = [*_head(run, plan, context), "", *table, ""]
    lines += [message.text for message in (*memory.messages(), disk_space(run, expected))]
    return "\n".join([*lines, expected.time_line(), *_folder_notes(run, update=update)])


def _head(run: Run, plan: Plan, context: Context) -> list[str]:
    config, images = run.config, run.scene.images
    count = len(images)
    notes = []
    distorted = len(missing_in(run.folder / CACHE, images))
    if distorted:
        what = "all" if distorted == count else f"{distorted:,}"
        notes.append(f"lens distortion is removed from {what} first")
    if not all(image.digest for image in images):
        notes.append("a run decodes them first and skips damaged ones")
    held_out = f"{len(run.test)} to test on"
    if run.validation:
        unused = counted(len(run.test), "test photo")
        held_out = f"{len(run.validation)} to validate on, {unused} unused"
    lines = [
        f"Plan of {run.folder}: preset {config.preset}, {config.strategy},"
        f" made for {config.roi.target.title}, seed {config.seed}",
        f"Photos: {count}, {len(run.train_scene.images)} to train on, {held_out}"
        + "".join(f"; {note}" for note in notes),
    ]
    for folder, selections in plan.selections.items():
        where = f" ({folder})" if folder else ""
        lines += [
            f"Box '{s.roi}'{where}: {counted(len(s.names), 'photo')} selected by {s.method}, of"
            f" {counted(len(s.candidates), 'candidate')}"
            for s in selections
        ]
    return [*lines, *_layout(run, context)]


def _layout(run: Run, context: Context) -> list[str]:
    """A line for each block and each group; none if there is one block and one box."""
    layout, lines = run.layout, []
    if layout.blocks:
        plans = cell_memory(run.scene, layout, run.config, context.photo_memory)
        lines = [
            f"{_cell(cell)}, {counted(len(cell.points), 'point')}, {in_gb(plan.total)}"
            for cell, plan in zip(layout.blocks.cells, plans, strict=False)
        ]
    if layout.cells:
        return lines + [_cell(cell) for cell in layout.cells.cells if "group" in cell.label]
    if len(run.rois) > 1 and run.config.strategy == "joint":
        lines.append(f"Boxes trained together: {', '.join(layout.groups[0])}")
    return lines


def _cell(cell: Cell) -> str:
    """For example `Block 2: vase, tin; 73 photos`."""
    boxes = ", ".join(roi.name for roi in cell.rois) or "no box"
    name = cell.label.replace("-", " ").capitalize()
    return f"{name}: {boxes}; {counted(len(cell.photos), 'photo')}"


def _row(expected: StageForecast) -> tuple[str, ...]:
    stage = expected.stage
    largest = max((i.camera for i in stage.images), key=lambda c: c.width * c.height)
    end, step = expected.end, expected.steps_done
    state = "done" if expected.is_done else f"{step:,} steps done" if step else ""
    names = list(dict.fromkeys(needed.name for needed in stage.start.stages))
    if len(names) > MOST_NAMES:
        names = [names[0], "…", names[-1]]
    return (
        stage.name,
        str(len(stage.images)),
        f"{largest.width}x{largest.height}",
        f"{stage.config.steps:,}",
        ", ".join(names) or "sparse points",
        f"{end:,}" if expected.is_done else f"~{round(end, -3):,}",
        f"{expected.seconds / 60:.1f}",
        state,
    )


def _folder_notes(run: Run, *, update: bool) -> list[str]:
    """Notes if an engine is at work in the folder, or the folder already has another run."""
    notes = []
    process = holder(run.folder / LOCK)
    if process:
        notes.append(f"Folder: process {process} is at work in it. Wait for it, or stop it.")
    path = run.folder / MANIFEST
    if not path.exists():
        return notes
    difference = manifest_difference(read_manifest(path), from_json(run.manifest()))
    if difference and update:
        notes.append(
            f"Folder: the results of another run ({difference}) would move to 'earlier' in it."
        )
    elif difference:
        notes.append(
            f"Folder: it has another run ({difference}). Add --update to move its results to"
            " 'earlier' in it."
        )
    return notes
