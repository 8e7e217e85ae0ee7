"""Options of how training is laid out: in blocks of the scene, in groups of boxes."""

from __future__ import annotations

import argparse
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..errors import RunFolderError
from ..formats.files import read_json
from ..formats.run_files import MANIFEST
from ..run.config import AUTO_BLOCKS, MOST_BLOCKS, RunConfig
from ..selection.cells import parsed_groups
from .values import NAME, Number, integer

AUTO = "auto"


@dataclass(frozen=True, kw_only=True)
class AutoOr(Number):
    """`auto`, or an integer in a range."""

    integer: bool = True

    def __call__(self, text: str) -> Any:
        """The value of a text."""
        return AUTO if text == AUTO else super().__call__(text)

    def of_json(self, value: Any) -> Any:
        """The value of an options file."""
        return AUTO if value == AUTO else super().of_json(value)

    def __str__(self) -> str:
        return f"{AUTO}, or {integer(int(self.low), int(self.high))}"


def add_layout_options(parser: argparse.ArgumentParser) -> None:
    """Blocks and groups."""
    group = parser.add_argument_group("large scenes, many boxes")
    group.add_argument(
        "--blocks",
        type=AutoOr(low=1, high=MOST_BLOCKS),
        metavar="N",
        help="cut the scene into N blocks that are trained one by one and joined; auto: as many as"
        " this machine's memory needs (default: 1)",
    )
    group.add_argument(
        "--group",
        type=NAME,
        action="append",
        default=[],
        metavar="BOX,BOX",
        help="boxes that are trained together, apart from the others; repeatable; all: all boxes"
        " (default: boxes that share photos)",
    )


def with_layout(config: RunConfig, args: argparse.Namespace, boxes: list[str]) -> RunConfig:
    """The config with these options.

    What `auto` has chosen before in the run folder stays, on whatever machine the run resumes.

    Args:
        config: of the other options.
        args: of the command.
        boxes: names of the boxes.

    Raises:
        ConfigError: `--group` names no box, or one twice.
    """
    blocks = args.blocks
    if blocks == AUTO:
        blocks = _blocks_before(args.run_dir) or AUTO_BLOCKS
    groups = parsed_groups(args.group, boxes) if args.group else ()
    return replace(config, blocks=1 if blocks is None else blocks, groups=groups)


def _blocks_before(folder: Path) -> int:
    """The blocks of the run in a folder; 0: there is none, or it is not cut."""
    with suppress(RunFolderError, AttributeError):
        found = read_json(folder / MANIFEST).get("config", {}).get("blocks", 0)
        return found if isinstance(found, int) and 1 < found <= MOST_BLOCKS else 0
    return 0
