"""The study: `python -m benchmarks.study SCENE ... --out DIR`; see benchmarks/README.md.

DIR/rows/SCENE/seed-N/ROW.json holds what was measured; a row with a record is not measured again.
Exit status: 0 all done, 2 something failed (the rest is done), 3 stopped on request.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.study.figures import write_figures
from benchmarks.study.measure import machine
from benchmarks.study.results import Results, load_records
from benchmarks.study.rows import TABLES, Row, all_rows, parse_variant, variant, wanted
from benchmarks.study.scenes import StudyScene, parse_scenes
from benchmarks.study.tables import Study, command_line
from benchmarks.study.work import Work
from roigs_engine.cli import exit_status_of
from roigs_engine.commands.console import Console
from roigs_engine.commands.process import run_process
from roigs_engine.commands.stopping import StopRequest
from roigs_engine.errors import ConfigError
from roigs_engine.formats.events import Failed
from roigs_engine.formats.files import read_json, write_json, write_text
from roigs_engine.kernels import library
from roigs_engine.requests.choices import PHOTOS, TEST
from roigs_engine.run.presets import PRESETS, preset
from roigs_engine.training.loop import one_torch_thread


def main(arguments: Sequence[str] | None = None, stop: StopRequest | None = None) -> int:
    """Measure what is missing, then write the tables; the exit status."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    options = _options(given)
    console = Console(json_lines=False, stop=stop)

    def work() -> int:
        console.watch()
        return _run(options, given, console)

    with one_torch_thread():
        return exit_status_of(work, console, "study")


def _run(options: argparse.Namespace, given: Sequence[str], console: Console) -> int:
    scenes = parse_scenes(options.scenes)
    if not scenes and not options.report_only:
        raise ConfigError("No scene is given.", "Name one, or add --report-only.")
    if options.threads is not None:
        library.set_threads(options.threads)
    _claim(options)
    variants = [parse_variant(text, options.preset) for text in options.vary]
    rows = wanted(all_rows(options.preset, variants), options.tables, options.rows)

    def report(*, figures: bool) -> None:
        _report(options, given, scenes, rows, console, figures=figures)

    failures: list[str] = []
    try:
        if not options.report_only:
            work = Work(
                folder=options.out,
                preset=options.preset,
                factor=options.steps,
                max_side=options.max_side,
                evaluate_on=options.evaluate_on,
                keep_models=options.keep_models,
                context=console.context,
            )
            failures = work.do(rows, scenes, options.seeds, lambda: report(figures=False))
    finally:
        report(figures=True)
    console.print(f"{options.out / 'study.md'}")
    for failure in failures:
        console.emit(Failed(message=failure))
    return 2 if failures else 0


def _claim(options: argparse.Namespace) -> None:
    """Write what a new folder is for; compare with what an old one is for.

    To report only, they are taken from the folder.

    Raises:
        ConfigError: the folder is for others.
    """
    path = options.out / "settings.json"
    names = ("preset", "steps", "max_side", "evaluate_on")
    settings = {name: getattr(options, name) for name in names}
    if path.exists():
        before = {"evaluate_on": TEST, **read_json(path)}  # older folders do not say
        if options.report_only:
            vars(options).update(before)
        elif before != settings:
            wrong = next(name for name in settings if before.get(name) != settings[name])
            raise ConfigError(
                f"{options.out} holds a study with {wrong} {before.get(wrong)}, not"
                f" {settings[wrong]}.",
                "Choose another --out.",
            )
    elif options.report_only:
        raise ConfigError(f"{options.out} holds no study.", "Leave --report-only out to begin one.")
    else:
        write_json(path, settings)


def _report(
    options: argparse.Namespace,
    given: Sequence[str],
    scenes: Sequence[StudyScene],
    rows: Sequence[Row],
    console: Console,
    *,
    figures: bool,
) -> None:
    """Write study.md and study.json, and the figures with them."""
    out, own = options.out, preset(options.preset).strategy
    records = load_records(out / "rows")
    results = Results(records, [scene.name for scene in scenes])
    shown = [*rows, *_other_variants(records, rows, options.preset)]
    drawn = write_figures(results, shown, own, out, console.emit) if figures else {}
    study = Study(
        results=results,
        rows=shown,
        tables=options.tables,
        own=own,
        head=_head(options, given, records),
        figures=drawn,
    )
    write_json(out / "study.json", study.to_dict())
    write_text(out / "study.md", study.markdown())


def _other_variants(
    records: Sequence[dict[str, Any]], rows: Sequence[Row], preset_name: str
) -> list[Row]:
    """The variants that were measured earlier and are not among the rows asked for now."""
    known = {row.name for row in (*all_rows(preset_name), *rows)}
    found = {}
    for record in records:
        name = str(record["row"])
        if name not in known:
            changes = tuple((str(field), value) for field, value in record["changes"])
            found[name] = variant(name, changes)
    return list(found.values())


def _head(
    options: argparse.Namespace, given: Sequence[str], records: Sequence[dict[str, Any]]
) -> dict[str, str]:
    """Facts for the top of the page."""
    machines = [record["machine"] for record in records] or [machine()]
    words = dict.fromkeys(
        f"{m['cpu']}, {m['cores']} cores, {m['threads']} threads, {m['kernels']},"
        f" torch {m['torch']}"
        for m in machines
    )
    dates = sorted({m["date"] for m in machines if "date" in m})
    config = preset(options.preset).scaled(options.steps)
    return {
        "machine": "; ".join(words),
        "measured": " to ".join(dict.fromkeys((dates[0], dates[-1]))) if dates else "nothing yet",
        "preset": f"{options.preset}, strategy {config.strategy}",
        "steps": f"{config.scene.steps} + {config.roi.steps} (× {options.steps:g})",
        "longest side": f"{options.max_side} px" if options.max_side else "of the photos",
        "evaluated on": f"{options.evaluate_on} photos",
        "command": command_line(given),
    }


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.study", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument(
        "scenes",
        nargs="*",
        metavar="SCENE",
        help="[NAME=]PATH[:ROIS.json] of a COLMAP project",
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write to")
    parser.add_argument("--preset", choices=sorted(PRESETS), default="draft")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2], metavar="N")
    parser.add_argument("--tables", nargs="+", choices=TABLES, default=["I", "II"])
    parser.add_argument("--rows", nargs="+", default=[], metavar="NAME", help="such as gp6-*")
    parser.add_argument(
        "--vary",
        action="append",
        default=[],
        metavar="NAME:FIELD=VALUE,...",
        help="a row of the preset with other settings; repeatable",
    )
    parser.add_argument(
        "--steps", type=float, default=1.0, metavar="F", help="multiply the steps of all stages"
    )
    parser.add_argument("--max-side", type=int, metavar="PX", help="longest side of the photos")
    parser.add_argument(
        "--evaluate-on", choices=PHOTOS, default=TEST, help="test photos, or validation photos"
    )
    parser.add_argument("--threads", type=int, metavar="N", help="CPU threads (default: all)")
    parser.add_argument(
        "--keep-models", action="store_true", help="keep the models of ablations and variants"
    )
    parser.add_argument("--report-only", action="store_true", help="measure nothing")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    run_process(lambda stop: main(stop=stop))
