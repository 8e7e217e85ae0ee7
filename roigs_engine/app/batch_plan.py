"""Plans of a batch's scenes: the parts of each run, and the output files of its result."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..batch.parts import PREPARE, WHOLE, Part, ScenePlan, Staging, cuts, needs, works
from ..batch.record import BatchRecord, Output
from ..context import QUIET, Context
from ..errors import ConfigError, EngineError
from ..formats import run_files
from ..formats.files import own_file
from ..formats.text import counted
from ..gpu.program import drawing
from ..machine import ENGINE
from ..requests.runs import TrainAndEvaluate
from .asked import Asked
from .batch_table import Row, Table, Wrong

if TYPE_CHECKING:
    from ..run.definition import Run
    from ..run.plan import Plan, Stage

OUTPUT_MEMORY = 4 * ENGINE
MOST_SHOWN = 100  # most mistakes of a table that are shown
TEST_WORK = 10.0  # work of rendering and comparing a test photo, in steps
PHOTOS_WORK = 1000.0  # work of photos without a model: unknown, but long


@dataclass(frozen=True, kw_only=True, eq=False)
class Planned:
    """A row's plan, with the run and its plan of stages; both are None without a COLMAP model."""

    scene: ScenePlan
    run: Run | None
    plan: Plan | None
    context: Context


def plan_row(row: Row, record: BatchRecord, context: Context) -> Planned:
    """Plan a row; EngineError if it cannot be done.

    This writes nothing and emits no messages: the engines of its parts will emit them.
    """
    from ..run.memory import stage_memory
    from ..run.strategies import plan_run

    context = replace(context, emit=QUIET.emit)
    asked = Asked.of(row.request)
    names = tuple(asked.boxes.names)
    outputs = outputs_of(row, names)
    if not asked.has_model:
        parts = _parts(row, 1, [], (("", PHOTOS_WORK),), {WHOLE: 0}) + _output_parts(row, outputs)
        scene = ScenePlan(name=row.name, objects=names, steps=(), parts=parts)
        return Planned(scene=scene, run=None, plan=None, context=context)
    run, context = asked.defined(context, pixels=False)
    whole = run.memory(context)
    plan = plan_run(run, asked.compare, context)
    cut = cuts(plan) if row.kind is TrainAndEvaluate else []
    largest = max(i.camera.width * i.camera.height for i in run.scene.images) / 1e6
    rest = (("", TEST_WORK * len(run.measured) * largest),)  # the evaluation, which is no stage
    own = rest if cut else (*works(plan.stages), *rest)
    memory = {PREPARE: whole.total, WHOLE: whole.joining if cut else whole.total}
    for stage in plan.stages:
        given = (run.train_scene, run.config, whole, context.photo_memory)
        memory[stage.name] = stage_memory(stage, *given)
    # On all machines, `auto` blocks are those of this machine.
    parts = _parts(row, run.config.blocks, cut, own, memory) + _output_parts(row, outputs)
    done = record.is_done(row.name, row.digest, run, files_of_run(row, names))
    missing = [output for output in outputs if done and not record.has_output(row.name, output)]
    if missing:
        parts = _output_parts(row, missing, needs=())
    scene = ScenePlan(
        name=row.name,
        objects=names,
        steps=tuple(stage.config.steps for stage in plan.stages),
        parts=parts,
        done=done and not missing,
    )
    return Planned(scene=scene, run=run, plan=plan, context=context)


def checked_plans(
    table: Table, rows: Sequence[Row], record: BatchRecord, context: Context
) -> tuple[str, list[ScenePlan]]:
    """Return the device of the rows, and their plans; ConfigError after warnings of mistakes."""
    device, scenes, wrong = "cpu", [], list(table.wrong)
    for row in rows:
        context.check_cancelled()
        try:
            found = plan_row(row, record, context)
        except EngineError as error:
            wrong.append(Wrong(line=row.line, text=f"Scene '{row.name}': {error}"))
            continue
        scenes.append(found.scene)
        device = drawing(found.context.device)
    for line in sorted(wrong, key=lambda found: found.line)[:MOST_SHOWN]:
        context.warn(f"{table.path}, line {line.line}: {line.text}")
    if wrong:
        raise ConfigError(
            f"{table.path} has {counted(len(wrong), 'mistake')}; nothing was started.",
            "Correct the mistakes listed above.",
        )
    return device, scenes


def _parts(
    row: Row,
    blocks: int,
    cut: Sequence[Sequence[Stage]],
    own: tuple[tuple[str, float], ...],
    memory: Mapping[str, int],
) -> tuple[Part, ...]:
    """Return the parts of a row's run: one per chain of `cut`, and the last with its `own` work."""
    evaluated = row.kind is TrainAndEvaluate
    command = ["run" if evaluated else "train", str(row.options_file)]
    command += ["--run-dir", str(row.run_dir), *(["--update"] if row.update else [])]
    command += ["--blocks", str(blocks)] if blocks > 1 else []

    def part(
        name: str, needs: tuple[str, ...], stages: tuple[tuple[str, float], ...], *before: str
    ) -> Part:
        named = (*before, name) if evaluated else ()
        return Part(
            scene=row.name,
            name=name,
            argv=(*command, *(word for each in named for word in ("--part", each))),
            needs=needs,
            work=sum(work for _, work in stages),
            memory=max(memory[stage] for stage in {name, *(n for n, _ in stages if n)}),
            gpu=row.options.get("device") != "cpu",
            stages=stages,
            staging=_staging(row),
        )

    firsts = [chain for chain in cut if not needs(chain)]
    found = [part(PREPARE, (), ())] if len(firsts) > 1 else []
    opened = tuple(other.name for other in found)
    for chain in cut:  # a first stage that all others need also prepares the folder
        before = (PREPARE,) if firsts == [chain] else ()
        found.append(part(chain[-1].name, needs(chain) or opened, works(chain), *before))
    found.append(part(WHOLE, tuple(other.name for other in found), own))
    return tuple(found)


def _staging(row: Row) -> Staging | None:
    if not row.store:
        return None
    base = str(row.run_dir.parent)
    return Staging(url=row.store, base=base, options=row.asked or row.options)


# --- files beside the run folders ---


def files_of_run(row: Row, objects: Sequence[str]) -> list[Path]:
    """Return the files of a row's run that others read, besides its result and report."""
    run = row.run_dir
    levels = [run / run_files.LEVELS_FILE] if row.options.get("levels") else []
    return [*(_of_object(run, name) for name in objects), *levels]


def outputs_of(row: Row, objects: Sequence[str]) -> list[Output]:
    """Return the files that a row writes beside its run folder, of the result and each object."""
    run, out = row.run_dir, row.run_dir.parent / run_files.BATCH_OUTPUTS
    found = [(f"{row.name}{suffix}", run / run_files.RESULT) for suffix in row.outputs]
    found += [
        (f"{row.name}/{name}{suffix}", _of_object(run, name))
        for suffix in row.object_outputs
        for name in objects
    ]
    given = sorted(row.output_options.items())
    options = tuple(f"--{name.replace('_', '-')}={value}" for name, value in given)
    return [Output(name=n, source=s, path=own_file(out, n), options=options) for n, s in found]


def _output_parts(
    row: Row, outputs: Iterable[Output], needs: tuple[str, ...] = (WHOLE,)
) -> tuple[Part, ...]:
    """Return a part for each output; `needs` is empty if the run is done."""
    return tuple(
        Part(
            scene=row.name,
            name=output.name,
            argv=("convert", *output.options, str(output.source), str(output.path)),
            needs=needs,
            memory=OUTPUT_MEMORY,
            staging=_staging(row),
        )
        for output in outputs
    )


def _of_object(run: Path, name: str) -> Path:
    return run / run_files.FINE / f"{name}.ply"
