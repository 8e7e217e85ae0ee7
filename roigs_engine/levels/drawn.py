"""A result drawn in levels of detail: the Gaussians that each view needs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import torch

from ..formats.levels import Ladder, read_ladders, shown_levels
from ..model.gaussians import Gaussians
from ..model.local_frame import LocalFrame
from ..model.operations import faded
from ..model.scene import Camera, Float64
from .parts import rate_of


class LevelledResult:
    """The result of a run, part by part, each in the level that a view needs.

    Files are read when they are first needed, and kept.

    Args:
        folder: of the run.
        frame: to compute in.
        quality: see `formats.levels.shown_levels`.
        device: of the Gaussians.

    Raises:
        RunFolderError: there are no levels, or a file is damaged.
    """

    def __init__(
        self,
        folder: Path,
        frame: LocalFrame,
        *,
        quality: float = 1.0,
        device: torch.device | None = None,
    ) -> None:
        self._folder, self._frame, self._quality = folder, frame, quality
        self._device = device or torch.device("cpu")
        self._ladders = [
            replace(ladder, probes=frame.points(ladder.probes), rate=ladder.rate / frame.scale)
            for ladder in read_ladders(folder).values()
        ]
        self._read: dict[str, Gaussians] = {}

    def gaussians(self, camera: Camera, world_to_camera: Float64) -> Gaussians:
        """The Gaussians that a view needs, in the frame.

        Args:
            camera: of the view.
            world_to_camera: (4, 4) from the frame.
        """
        parts = []
        for ladder in self._ladders:
            for ply, density in self.shown(ladder, camera, world_to_camera):
                part = self._part(ply)
                logits = faded(part.logit_opacities, density)
                parts.append(replace(part, logit_opacities=logits))
        return Gaussians.concatenate(parts)

    def shown(
        self, ladder: Ladder, camera: Camera, world_to_camera: Float64
    ) -> list[tuple[str, float]]:
        """The files of a part that a view needs, and their densities."""
        rate = rate_of(ladder.probes, (camera, world_to_camera))
        levels = shown_levels(ladder, rate, self._quality)
        return [(level.ply, density) for level, density in levels]

    def _part(self, ply: str) -> Gaussians:
        if ply not in self._read:
            read = Gaussians.load_ply(self._folder / ply, self._frame)
            self._read[ply] = read.to(self._device)
        return self._read[ply]
