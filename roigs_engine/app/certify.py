"""Writes certificates of boxed objects: one page each, and a section in their run's reports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..context import QUIET, Context
from ..errors import RunFolderError
from ..formats import run_files
from ..formats.files import read_record, sha256, write_json, write_text
from ..formats.lock import locked
from ..formats.report_scores import scores_of_result
from ..formats.text import markdown_text
from ..requests.projects import Certify
from .inputs import boxes_of, load_scene, mask_options
from .outputs import Result, refuse_inputs, refuse_run_files
from .run_scene import warn_of_other_model
from .suggest import units_of
from .surface_record import put_section

if TYPE_CHECKING:
    from ..guidance.certificate import Certificate

RECORD = "certificates.json"
TITLE = "Certificates"


@dataclass(frozen=True, kw_only=True)
class Certified(Result):
    """The certificates of the boxes, in their order."""

    certificates: tuple[Certificate, ...]


def certify(request: Certify, context: Context = QUIET) -> Certified:
    """Write a certificate for each box; EngineError if the scene, a box or the run is unusable."""
    from ..guidance.certificate import certificate, certificate_page
    from ..guidance.known import known_box
    from ..model.mask_coverage import with_useful_masks

    refuse_run_files(request.out)
    rois = boxes_of(request)
    pages = {roi.name: request.out / f"{roi.name}.html" for roi in rois}
    refuse_inputs([*pages.values(), request.out / RECORD], [request.options_file, request.rois])
    run = _Run.of(request.run_dir)
    if request.run_dir is not None:
        warn_of_other_model(request.run_dir, request.scene, request.images, context)
    masks = mask_options(request, [roi.name for roi in rois])
    scene = load_scene(request, context, contents=True, masks=masks)
    scene = with_useful_masks(scene.without(run.tests), rois, context)
    units = units_of(request.scene, scene, context)
    made = []
    for roi in rois:
        context.check_cancelled()
        known = known_box(scene, roi, context)
        found = certificate(known, units, run.scores(roi.name), run.facts(roi.name))
        write_text(pages[roi.name], certificate_page(found))
        made.append(found)
    write_json(request.out / RECORD, {"certificates": [each.to_dict() for each in made]})
    if request.run_dir is not None:
        with locked(request.run_dir, context.warn, option=None):
            _add_to_reports(request.run_dir, made)
    done = Certified(certificates=tuple(made), files={**pages, "record": request.out / RECORD})
    return done.with_places(*(each.text for each in made))


@dataclass(frozen=True, kw_only=True)
class _Run:
    """A run folder's facts about its objects; all empty without a run folder."""

    folder: Path | None
    tests: tuple[str, ...]
    all_scores: dict[str, dict[str, float]]  # by box
    provenance: dict[str, Any]

    @classmethod
    def of(cls, folder: Path | None) -> _Run:
        if folder is None:
            return cls(folder=None, tests=(), all_scores={}, provenance={})
        if not (folder / run_files.RESULT).is_file():
            raise RunFolderError(
                f"{folder} is not the folder of a finished run.", "Give that of --run-dir."
            )

        def read(name: str) -> dict[str, Any]:
            return read_record(folder / name) if (folder / name).is_file() else {}

        tests = tuple(map(str, _listed(read(run_files.SPLIT).get("test"), str)))
        return cls(
            folder=folder,
            tests=tests,
            all_scores=scores_of_result(folder),
            provenance=read("provenance.json"),
        )

    def scores(self, box: str) -> dict[str, float]:
        """Return the scores of the run's own model on its test photos."""
        from ..guidance.certificate import SCORES

        found = self.all_scores.get(box, {})
        return {k: float(found[k]) for k, _, _ in SCORES if k in found}

    def facts(self, box: str) -> dict[str, str]:
        """Return software, settings, dates and hashes of a box's result."""
        if self.folder is None:
            return {}
        entries = _listed(self.provenance.get("entries"), dict)
        last = entries[-1] if entries else {}
        versions = last.get("versions")
        versions = versions if isinstance(versions, dict) else {}
        settings = {}
        if (self.folder / run_files.SETTINGS).is_file():
            settings = read_record(self.folder / run_files.SETTINGS)
        shown = {k: v for k, v in settings.items() if not any(c in str(v) for c in "/\\")}
        facts = {
            "Trained": str(last.get("started", "")),
            "Software": ", ".join(f"{name} {number}" for name, number in versions.items()),
            "Settings": ", ".join(f"{name} {value}" for name, value in shown.items()),
            "Test photos": str(len(self.tests)),
            "SHA-256 of the scene's result": sha256(self.folder / run_files.RESULT),
        }
        own = self.folder / run_files.FINE / f"{box}.ply"
        if own.is_file():
            facts["SHA-256 of the object's Gaussians"] = sha256(own)
        return {name: text for name, text in facts.items() if text}


def _listed(value: Any, kind: type) -> list[Any]:
    """Return the values of a type in a list of a run's record, which may hold anything."""
    return [each for each in value if isinstance(each, kind)] if isinstance(value, list) else []


def _add_to_reports(run: Path, made: Sequence[Certificate]) -> None:
    """Put the certificates at the end of the run's reports, in place of earlier ones."""
    from ..guidance.certificate import section

    lines = [f"- {markdown_text(each.text)}" for each in made]
    put_section(run / run_files.REPORT, TITLE, [f"## {TITLE}", "", *lines, ""])
    parts = [part for each in made for part in section(each)]
    page = run / run_files.REPORT_PAGE
    put_section(page, TITLE, [f"<h2>{TITLE}</h2>", *parts], before="<script>")
