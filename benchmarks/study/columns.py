"""Content of the study's tables: lines, columns, notes."""

from __future__ import annotations

from benchmarks.study import rows
from benchmarks.study.rows import INDEPENDENT, JOINT
from roigs_engine.evaluation.scores import FULL_SCENE as BASELINE
from roigs_engine.evaluation.scores import FULL_SCENE_TUNED as TUNED

# A line of a table: what it is called, the row it comes from, the model of that row.
Line = tuple[str, str, str]

LINES: tuple[Line, ...] = (
    (BASELINE, rows.FULL_SCENE, BASELINE),
    (TUNED, rows.TUNED, TUNED),
    (f"{TUNED}, one stage", rows.ONE_STAGE, f"{TUNED}, one stage"),
    ("Full Object", rows.FULL_OBJECT, "Full Object"),
    ("Full Object, tuned", rows.OBJECT_TUNED, "Full Object, tuned"),
    ("Full Scene, budget-matched", rows.MATCHED, "Matched"),
    (f"{TUNED}, budget-matched", rows.MATCHED_TUNED, "Matched, tuned"),
    ("Scene-GS", INDEPENDENT, "Scene-GS"),
    ("Object-GS", INDEPENDENT, "Object-GS"),
    ("Composition", INDEPENDENT, "Composition"),
    ("Object-GS (refined)", rows.REFINED, "Object-GS"),
    ("Composition, refined", rows.REFINED, "Composition, refined"),
    ("Scene-GS (joint)", JOINT, "Scene-GS (joint)"),
    ("Joint", JOINT, "Joint"),
    ("Joint, equal time", rows.EQUAL_TIME, "Joint, equal time"),
)
IN_TABLE_TWO = (
    *(BASELINE, TUNED, "Matched", "Matched, tuned"),
    *("Composition", "Composition, refined", "Joint", "Joint, equal time"),
)
RESULT = {INDEPENDENT: ("Composition", "Scene-GS"), JOINT: ("Joint", "Scene-GS (joint)")}
"""Strategy -> its result's model, and its Scene-GS's."""

# Heading, metric, format.
Column = tuple[str, str, str]

OVER_PLAIN: Column = ("over Full Scene", "full_scene_gain", "+.2f")
"""Where gains are over the tuned Full Scene: those over the plain one, beside them."""
TABLE_ONE: tuple[Column, ...] = (
    ("ROI PSNR", "roi_psnr", ".2f"),
    ("gain", "gain", "+.2f"),
    OVER_PLAIN,
    ("SSIM", "roi_ssim", ".4f"),
    ("FLIP", "roi_flip", ".4f"),
    ("object PSNR", "object_psnr", ".2f"),
    ("image PSNR", "image_psnr", ".2f"),
    ("Gaussians", "gaussians", ",.0f"),
    ("in box", "in_box", ",.0f"),
    ("s", "seconds", ",.0f"),
    ("CPU s", "cpu_seconds", ",.0f"),
    ("CPU ×", "cpu_ratio", ".2f"),
    ("MB", "megabytes", ".1f"),
)
TABLE_ONE_PHOTOS: tuple[Column, ...] = (
    ("near PSNR", "near_psnr", ".2f"),
    ("gain", "near_gain", "+.2f"),
    ("far PSNR", "far_psnr", ".2f"),
    ("gain", "far_gain", "+.2f"),
    ("peak gain", "peak_gain", "+.2f"),
    ("worst gain", "worst_gain", "+.2f"),
    ("photos won", "won_share", ".0%"),
)
TABLE_TWO_GAINS: tuple[Column, ...] = (
    ("corrected gain", "corrected_gain", "+.2f"),
    ("object gain", "object_gain", "+.2f"),
    ("detail gain", "detail_gain", "+.2f"),
    ("image gain", "image_gain", "+.2f"),
)
TABLE_TWO_PHOTOS: tuple[Column, ...] = (
    ("near gain", "near_gain", "+.2f"),
    ("far gain", "far_gain", "+.2f"),
    ("peak gain", "peak_gain", "+.2f"),
    ("worst gain", "worst_gain", "+.2f"),
    ("photos won", "won_share", ".0%"),
    ("SSIM gain", "ssim_gain", "+.4f"),
    ("FLIP change", "flip_gain", "+.4f"),
)
TABLE_THREE: tuple[Column, ...] = (
    ("photos", "selected", ".0f"),
    ("ROI PSNR", "roi_psnr", ".2f"),
    ("gain", "gain", "+.2f"),
    ("SSIM", "roi_ssim", ".4f"),
    ("object PSNR", "object_psnr", ".2f"),
    ("in box", "in_box", ",.0f"),
    ("CPU ×", "cpu_ratio", ".2f"),
)
NOTES = """\
Gains are over {baseline} of the same seed, in dB. ROI: the silhouette of the box; object: those of
its pixels whose expected depth in Full Scene is in the box, the same in every row of a scene and
seed; corrected: ROI PSNR after a correction of each photo's colours; detail: of what a blur of 2 px
takes away; peak and worst gain: the largest and the least on one {photos} photo; photos won: the
share with a gain; near, far: on the third of the {photos} photos with the nearest cameras, and on
the farthest third (none for fewer than three photos, and the mean of all boxes is then that of the
others); FLIP: mean error over the silhouette, lower is better. ± is the sample's standard deviation
over seeds; † one seed only; - not measured. s: training, wall-clock; CPU s: the same by the
process's clock, all threads; CPU × and Gaussians ×: relative to {baseline}; over matched: relative
to {baseline}, budget-matched. Composition and Object-GS: the time for this box alone. SSIM: 11 × 11
Gaussian window, sigma 1.5, mean over the silhouette. MB: 10^6 bytes of the PLY."""
THREE_NOTES = """\
Each line changes one thing of the strategy: its photos or its start. All of them begin from the
strategy's own Scene-GS, which another selection does not change here. 48 %: what the preset selects
(48 % of the candidates, 150 photos at most). Scores are the composition's (joint: the joint
model's). Over unchanged: against the strategy's own row, seed by seed."""
