"""The files that a row of a batch writes beside its run folder, and the parts that make them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from ..batch.parts import WHOLE, Part
from ..batch.record import Output
from ..formats import run_files
from ..machine import ENGINE
from .batch_store import staging
from .batch_table import Row

MEMORY = 4 * ENGINE


def run_folder(row: Row, folder: Path) -> Path:
    """The run folder of a row; `folder` is that of the batch."""
    return row.home or folder / row.name


def files_of_run(row: Row, folder: Path, objects: Sequence[str]) -> list[Path]:
    """The files of a row's run that others read, beside its result and report."""
    run = run_folder(row, folder)
    levels = [run / run_files.LEVELS_FILE] if row.args.levels else []
    return [*(_of_object(run, name) for name in objects), *levels]


def outputs_of(row: Row, folder: Path, objects: Sequence[str]) -> list[Output]:
    """The files that a row writes beside its run folder, of the result and of each object."""
    run, out = run_folder(row, folder), folder / run_files.BATCH_OUTPUTS
    found = [(f"{row.name}{suffix}", run / run_files.RESULT) for suffix in row.outputs]
    found += [
        (f"{row.name}/{name}{suffix}", _of_object(run, name))
        for suffix in row.object_outputs
        for name in objects
    ]
    given = sorted(row.output_options.items())
    options = tuple(f"--{name.replace('_', '-')}={value}" for name, value in given)
    return [Output(name=n, source=s, path=out / n, options=options) for n, s in found]


def output_parts(
    row: Row, folder: Path, outputs: Iterable[Output], needs: tuple[str, ...] = (WHOLE,)
) -> tuple[Part, ...]:
    """A part for each output; `needs` is empty if the run is done."""
    return tuple(
        Part(
            scene=row.name,
            name=output.name,
            argv=("convert", *output.options, str(output.source), str(output.path)),
            needs=needs,
            memory=MEMORY,
            staging=staging(row, folder, output.name),
        )
        for output in outputs
    )


def _of_object(run: Path, name: str) -> Path:
    """The PLY of an object."""
    return run / run_files.FINE / f"{name}.ply"
