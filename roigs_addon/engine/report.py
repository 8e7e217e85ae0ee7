"""What the engine's report of a result says (docs/files.md, section report.json). No bpy."""

from __future__ import annotations

from pathlib import Path

from ..shared import EngineError, files, run_files, text


def psnr(folder: Path) -> str:
    """'27.4 dB on 5 test photos', the mean of all boxes; empty if it was not measured.

    Args:
        folder: a run folder, or an archived result.
    """
    try:
        report = files.read_json(folder / run_files.REPORT_DATA)
        found = [box["rows"][-1]["roi_psnr"] for box in report["rois"]]  # the last row: the result
        values = [float(value) for value in found if value is not None]
        photos = text.counted(len(report["test_views"]), f"{report.get('photos', 'test')} photo")
    except (EngineError, KeyError, TypeError, ValueError, IndexError):
        return ""
    return f"{sum(values) / len(values):.1f} dB on {photos}" if values else ""
