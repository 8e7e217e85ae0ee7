"""Families: run folders whose records and checkpoints are damaged; a command resumes each."""

from __future__ import annotations

import contextlib
import copy
import functools
import io
import json
import math
import random
import struct
import tempfile
import zlib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from roigs_engine.formats.text import json_digest
from roigs_engine.run.stage_folder import CHECKSUM
from tests.fuzz import inputs
from tests.fuzz.cases import (
    QUICK,
    Case,
    Command,
    good_boxes,
    good_scene,
    json_bytes,
    odd_tree,
    write,
)
from tests.fuzz.damage import ODD_FLOATS, ODD_TEXTS, ODD_VALUES, bytes_damaged


def training(folder: Path) -> Command:
    """A training of a few steps, in `folder`/out."""
    scene = good_scene(folder)
    run = ["--rois", good_boxes(folder), "--run-dir", str(folder / "out")]
    return ["train", str(scene), *run, *QUICK]


def run_folders(dice: random.Random, folder: Path) -> Case:
    """A run folder whose records are damaged."""
    scene = good_scene(folder)
    boxes = good_boxes(folder)
    out = folder / "out"
    tree = {
        "config": {"preset": "draft", "seed": 0},
        "rois": [inputs.TURNED],
        "photos": 4,
        "sizes": ["24x18"],
    }
    for name in ("request.json", "split.json", "run.lock", "selection/thing.json"):
        if dice.random() < 0.6:
            write(out / name, json_bytes(dice, odd_tree(dice, tree)))
    command = ["claim", str(scene), "--rois", boxes, "--max-side", "24", "--run-dir", str(out)]
    return Case(command + ["--update"] * dice.randrange(2))


@functools.cache
def run_files(stage: int = 0) -> dict[str, bytes]:
    """The files of a good run folder; of one that was stopped in its first or second stage."""
    from roigs_engine import cli
    from roigs_engine.commands.console import Console
    from roigs_engine.training.trainer import Trainer

    step = Trainer.train_step
    trainers: list[Trainer] = []

    def train_step(trainer: Trainer) -> None:
        step(trainer)
        if trainer not in trainers:
            trainers.append(trainer)

    def should_stop(console: Console) -> bool:
        return 0 < stage == len(trainers) and trainers[-1].step >= 2

    with tempfile.TemporaryDirectory(prefix="roigs-fuzz-") as name:
        folder = Path(name)
        silent = io.StringIO()
        with (
            contextlib.redirect_stderr(silent),
            contextlib.redirect_stdout(silent),
            mock.patch.object(Console, "should_stop", should_stop),
            mock.patch.object(Trainer, "train_step", train_step),
        ):
            status = cli.main(training(folder))
        assert status == (3 if stage else 0), silent.getvalue()
        out = folder / "out"
        return {
            str(p.relative_to(out)): p.read_bytes() for p in sorted(out.rglob("*")) if p.is_file()
        }


def stopped_runs() -> tuple[dict[str, bytes], ...]:
    """Runs that were stopped in the first and in the second stage, with a checkpoint."""
    return run_files(1), run_files(2)


def resumed(dice: random.Random, folder: Path, files: dict[str, bytes]) -> Case:
    """The command that resumes the run of these files."""
    for name, data in files.items():
        write(folder / "out" / name, data)
    command = training(folder)
    return Case(command + ["--update"] * (dice.random() < 0.3))


def stage_records(dice: random.Random, folder: Path) -> Case:
    """A run folder whose records (JSON files) are damaged."""
    files = dict(dice.choice((run_files(), run_files(), *stopped_runs())))
    names = [name for name in files if name.endswith(".json")]
    for name in dice.sample(names, dice.choice((1, 1, 2))):
        tree = json.loads(files[name])
        match dice.randrange(6):
            case 0:
                files[name] = bytes_damaged(dice, files[name])
            case 1:
                files[name] = json_bytes(dice, dice.choice(ODD_VALUES))
            case 2 if isinstance(tree, dict) and tree:
                tree[dice.choice(list(tree))] = dice.choice(ODD_VALUES)
                if CHECKSUM in tree:  # whoever gives a run away can make the right one
                    tree.pop(CHECKSUM)
                    tree[CHECKSUM] = json_digest(tree)
                files[name] = json_bytes(dice, tree)
            case 3 if name.endswith("stage.json"):
                tree["fingerprint"] = dice.choice(
                    (*ODD_TEXTS, "/../../x", "../../..", "\0" * 8, [], 5)
                )
                files[name] = json_bytes(dice, tree)
            case _:
                files[name] = json_bytes(dice, odd_tree(dice, tree))
    if dice.random() < 0.2:
        del files[dice.choice(list(files))]
    return resumed(dice, folder, files)


def header_of(data: bytes) -> tuple[Any, bytes]:
    """Header and tensors of a checkpoint."""
    length = struct.unpack_from("<8sQI", data)[1]
    return json.loads(data[20 : 20 + length]), data[20 + length : -4]


def sealed(header: Any, tensors: bytes) -> bytes:
    """A checkpoint with valid checksums."""
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    head = struct.pack("<8sQI", b"ROIGSck3", len(text), zlib.crc32(text))
    return head + text + tensors + struct.pack("<I", zlib.crc32(tensors))


ODD_TENSORS = (
    *(["float64", [3]], ["int64", [3, 3]], ["bool", []], ["pickle", [1]], ["float32", [10**15]]),
    *(["float32", [-1]], ["float32", "x"], ["float32", [1.5]], [[], []], {}, None, "__import__"),
    *(["float32", [0]], ["float32", [0, 10**30]], ["uint8", [1] * 70], ["float32", [[2]]]),
)


def checkpoints(dice: random.Random, folder: Path) -> Case:
    """Checkpoints of valid checksums with fields, shapes, types and numbers that are wrong."""
    files = dict(dice.choice(stopped_runs()))
    names = [name for name in files if name.endswith("checkpoint.bin")]
    for name in names:
        header, tensors = header_of(files[name])
        match dice.randrange(8):
            case 0 | 1:
                header["state"] = odd_tree(dice, header["state"])
            case 2:
                places = list(tensor_places(header["state"]))
                home, key = dice.choice(places)
                home[key] = {"<tensor>": copy.deepcopy(dice.choice(ODD_TENSORS))}
            case 3:
                places = list(tensor_places(header["state"]))
                home, key = dice.choice(places)
                shape = home[key]["<tensor>"][1]
                shape[:] = dice.choice((shape[::-1], [math.prod(shape)], [*shape, 1], [1, *shape]))
            case 4 | 5 if len(tensors) >= 8:
                bad = bytearray(tensors)
                for _ in range(dice.choice((1, 1, 50))):
                    at = 4 * dice.randrange(len(bad) // 4)
                    value = dice.choice((*ODD_FLOATS, 1e30, -1e30, 88.0, 1e-40))
                    with np.errstate(all="ignore"):
                        bad[at : at + 4] = np.float32(value).tobytes()
                tensors = bytes(bad)
            case 6:
                key = dice.choice(("step", "seconds", "cpu_seconds", "loss", "psnr"))
                header["state"][key] = copy.deepcopy(dice.choice(ODD_VALUES))
            case _:
                part = dice.choice([k for k, v in header["state"].items() if isinstance(v, dict)])
                header["state"][part] = odd_tree(dice, header["state"][part])
        if dice.random() < 0.1:
            header = dice.choice(([], {}, b"[" * 9000, {"fingerprint": header["fingerprint"]}, 5))
        try:
            files[name] = sealed(header, tensors)
        except (ValueError, TypeError, UnicodeError):
            files[name] = sealed({}, b"")
        if dice.random() < 0.3:
            before = name.replace("checkpoint.bin", "checkpoint.before.bin")
            files[before] = dice.choice((files[name], b"", sealed({"state": 1}, b"")))
    return resumed(dice, folder, files)


def tensor_places(state: Any) -> Iterable[tuple[Any, Any]]:
    """Every (dict, key) of a tensor's placeholder."""
    for key, value in state.items():
        if isinstance(value, dict):
            if "<tensor>" in value:
                yield state, key
            else:
                yield from tensor_places(value)


FAMILIES: dict[str, tuple[Callable[[random.Random, Path], Case], int]] = {
    "run_folders": (run_folders, 120),
    "stage_records": (stage_records, 350),
    "checkpoints": (checkpoints, 350),
}
