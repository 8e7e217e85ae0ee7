"""Reads the engine's report of a result (docs/files.md, section report.json). No bpy."""

from __future__ import annotations

from pathlib import Path

from ..shared import EngineError, files, run_files, text


def psnr(folder: Path, side: int | None = None) -> str:
    """Return the mean PSNR of all boxes, as '27.4 dB at 640 px on 5 test photos'.

    It is empty if none was measured.

    Args:
        folder: a run folder, or an earlier result.
        side: longest side of the photos, if known: PSNRs of different sizes cannot be compared.
    """
    try:
        report = files.read_json(folder / run_files.REPORT_DATA)
        found = [box["rows"][-1]["roi_psnr"] for box in report["rois"]]  # the last row: the result
        values = [float(value) for value in found if value is not None]
        photos = text.counted(len(report["test_views"]), f"{report.get('photos', 'test')} photo")
    except (EngineError, KeyError, TypeError, ValueError, IndexError, OverflowError):
        return ""
    size = f" at {side} px" if side else ""
    return f"{sum(values) / len(values):.1f} dB{size} on {photos}" if values else ""
