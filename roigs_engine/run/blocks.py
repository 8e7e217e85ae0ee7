"""The number of blocks that a scene is cut into."""

from __future__ import annotations

import math
from dataclasses import replace

from ..context import QUIET, Context
from ..errors import SceneError
from ..formats.text import counted, in_gb
from ..machine import machine_memory
from ..model.roi import OrientedBox
from ..model.scene import SfmScene
from ..requests.choices import MOST_BLOCKS
from ..selection.cells import Groups
from .config import AUTO_BLOCKS, RunConfig
from .layout import Layout, given_groups, lay_out

FEWEST = 24  # photos of a block: with fewer, its surroundings are guessed
USELESS = 0.9  # of the photos in the usual block: cutting saves next to nothing


def number_of_blocks(
    scene: SfmScene,
    train: SfmScene,
    rois: tuple[OrientedBox, ...],
    config: RunConfig,
    context: Context = QUIET,
) -> int:
    """The blocks that a run gets: as asked for, or fewer; says why.

    Args:
        scene: with its test photos.
        train: without.
        rois, config: of the run.
        context: gets the lines.

    Raises:
        RoiError: no photo sees one of the boxes.
    """
    if config.blocks == 1:
        return 1
    layouts = _Layouts(train, rois, given_groups(config, rois), context)
    if config.blocks == AUTO_BLOCKS:
        return _by_memory(scene, layouts, config, context)
    found = next(n for n in range(config.blocks, 0, -1) if n == 1 or layouts.fewest(n) >= FEWEST)
    if found < config.blocks:
        what = f"into {found} blocks instead of {config.blocks}"
        what = f"The scene is cut {what}" if found > 1 else "The scene is not cut into blocks"
        context.warn(
            f"{what}: of {counted(len(train.images), 'photo')}, one of {found + 1} blocks would"
            f" have fewer than {FEWEST}."
        )
    if found > 1 and layouts.usual(found) > USELESS:
        context.warn(
            f"Blocks save little here: {layouts.usual(found):.0%} of the photos show the usual"
            " block, as in photos taken around one thing."
        )
    return found


class _Layouts:
    """Layouts of a scene by the number of blocks, each made once."""

    def __init__(
        self,
        scene: SfmScene,
        rois: tuple[OrientedBox, ...],
        groups: Groups | None,
        context: Context,
    ) -> None:
        self.scene, self.rois, self.groups, self.context = scene, rois, groups, context
        self._made: dict[int, Layout] = {}

    def of(self, count: int) -> Layout:
        """The layout with so many blocks."""
        if count not in self._made:
            self._made[count] = lay_out(self.scene, self.rois, count, self.groups, self.context)
        return self._made[count]

    def photos(self, count: int) -> list[int]:
        """The number of photos of each block, ascending."""
        blocks = self.of(count).blocks
        return sorted(len(c.photos) for c in blocks.cells) if blocks else [len(self.scene.images)]

    def fewest(self, count: int) -> int:
        """Photos of the block with the fewest."""
        return self.photos(count)[0]

    def usual(self, count: int) -> float:
        """Share of the photos that the usual block has."""
        photos = self.photos(count)
        return photos[len(photos) // 2] / max(len(self.scene.images), 1)


def _by_memory(scene: SfmScene, layouts: _Layouts, config: RunConfig, context: Context) -> int:
    """The fewest blocks that fit into this machine's memory; 1 if none do."""
    machine = machine_memory()
    needed = _needed(scene, layouts.of(1), config, context)
    if needed <= machine:
        return 1
    for count in range(2, MOST_BLOCKS + 1):
        context.check_cancelled()
        if layouts.fewest(count) < FEWEST:
            break
        if layouts.usual(count) <= USELESS:
            each = _needed(scene, layouts.of(count), config, context)
            if each <= machine:
                whole = in_gb(int(needed)) if math.isfinite(needed) else "more"
                context.info(
                    f"The scene is cut into {count} blocks that need {in_gb(int(each))} each; as"
                    f" one it would need {whole}, and this machine has {in_gb(machine)}."
                )
                return count
    reason = (
        "the photos all show most of it"
        if layouts.usual(2) > USELESS
        else f"blocks with {FEWEST} photos or more do not fit either"
    )
    context.warn(f"The scene is not cut into blocks: {reason}. Use a smaller --max-side.")
    return 1


def _needed(scene: SfmScene, layout: Layout, config: RunConfig, context: Context) -> float:
    """Bytes that training needs; infinite if it could not even begin."""
    from .memory import layout_memory  # with torch

    settings = replace(config, blocks=1)
    try:
        return layout_memory(scene, layout, settings, context.photo_memory).total
    except SceneError:
        return math.inf
