"""Checkpoints: what goes in comes out; a damaged one is named, and the previous one is used."""

from __future__ import annotations

import errno
import math
import zlib
from pathlib import Path
from typing import Any

import pytest
import torch

from roigs_engine.context import Context
from roigs_engine.errors import RunFolderError
from roigs_engine.formats.events import Event, Message
from roigs_engine.training import checkpoint
from roigs_engine.training.checkpoint import (
    checkpoint_exists,
    load_checkpoint,
    remove_checkpoint,
    save_checkpoint,
)

STATE: dict[str, Any] = {
    "step": 1 << 40,
    "seconds": 0.1 + 0.2,
    "psnr": math.nan,
    "name": "Büste",
    "empty": {},
    "nested": {
        "means": torch.linspace(-1, 1, 300_003).reshape(-1, 3),  # more than one chunk
        "turned": torch.arange(12.0).reshape(3, 4).t(),
        "scalar": torch.tensor(7, dtype=torch.int64),
        "none": torch.zeros(0, 3),
        "views": torch.arange(5, dtype=torch.int32),
        "seen": torch.tensor([True, False]),
    },
}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Of a checkpoint at step 1, and one at step 0 before it."""
    for step in (0, 1):
        save_checkpoint(tmp_path / "stage" / "checkpoint.bin", state(step), "one")
    return tmp_path / "stage" / "checkpoint.bin"


def state(step: int) -> dict[str, Any]:
    return {"step": step, "rows": torch.full((5, 3), float(step))}


def test_what_goes_in_comes_out(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.bin"
    save_checkpoint(path, STATE, "one")
    back = load_checkpoint(path, "one")
    assert list(back) == list(STATE)
    for key in ("step", "seconds", "name", "empty"):
        assert back[key] == STATE[key]
    assert math.isnan(back["psnr"])
    for name, tensor in STATE["nested"].items():
        assert back["nested"][name].dtype == tensor.dtype
        assert torch.equal(back["nested"][name], tensor)


def test_the_one_before_is_kept_and_both_go(path: Path) -> None:
    assert load_checkpoint(path, "one")["step"] == 1
    path.unlink()  # killed between the two renamings
    assert checkpoint_exists(path)
    assert load_checkpoint(path, "one")["step"] == 0
    save_checkpoint(path, state(2), "one")
    remove_checkpoint(path)
    assert not checkpoint_exists(path) and not list(path.parent.iterdir())


def test_another_stage_is_refused(path: Path) -> None:
    with pytest.raises(RunFolderError, match="has other settings"):
        load_checkpoint(path, "two")


@pytest.mark.parametrize("share", [0.0, 0.02, 0.05, 0.3, 0.6, 0.99])
@pytest.mark.parametrize("damage", ["cut", "flip", "longer"])
def test_a_damaged_one_is_named_and_the_one_before_used(
    path: Path, damage: str, share: float
) -> None:
    whole = path.read_bytes()
    place = int(share * len(whole))
    if damage == "flip":
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 4]) + whole[place + 1 :])
    else:
        path.write_bytes(whole[:place] if damage == "cut" else whole + b"x" * (place + 1))
    events: list[Event] = []
    back = load_checkpoint(path, "one", Context(emit=events.append))
    assert back["step"] == 0 and torch.equal(back["rows"], state(0)["rows"])
    (message,) = events
    assert isinstance(message, Message) and message.level == "warning"
    assert str(path) in message.text and "the previous checkpoint" in message.text
    path.with_name("checkpoint.before.bin").write_bytes(b"")
    with pytest.raises(RunFolderError, match=r"checkpoint\.bin .*Delete it"):
        load_checkpoint(path, "one")


def test_one_of_an_earlier_version_is_refused_and_not_run(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.bin"
    torch.save({"step": 1}, path)
    with pytest.raises(RunFolderError, match="another version"):
        load_checkpoint(path, "one")


def test_lengths_are_checked_before_memory_is_asked_for(path: Path) -> None:
    whole = path.read_bytes()
    path.write_bytes(checkpoint.PREFIX.pack(checkpoint.MAGIC, 1 << 60, 0) + whole[20:])
    path.with_name("checkpoint.before.bin").unlink()
    with pytest.raises(RunFolderError, match="incomplete"):
        load_checkpoint(path, "one")


@pytest.mark.parametrize(
    "header",
    [
        b"[]",
        b"{}",
        b'{"fingerprint": 1}',
        b"\xff",
        *(
            b'{"fingerprint": "one", "state": {"a": {"<tensor>": %s}}}' % wrong
            for wrong in (
                b"1",
                b'["pickle", [1]]',
                b'["float32", [-1]]',
                b'["float32", [1152921504606846976]]',
            )
        ),
    ],
)
def test_a_header_that_makes_no_sense(path: Path, header: bytes) -> None:
    path.write_bytes(checkpoint.PREFIX.pack(checkpoint.MAGIC, len(header), zlib.crc32(header)))
    with open(path, "ab") as file:
        file.write(header + bytes(64))
    assert load_checkpoint(path, "one")["step"] == 0


def test_a_full_disk_leaves_what_was_there(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(tensors: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(checkpoint, "_chunks", full)
    with pytest.raises(RunFolderError, match=r"No space left on device.*Free some space"):
        save_checkpoint(path, state(2), "one")
    monkeypatch.undo()
    assert load_checkpoint(path, "one")["step"] == 1
    assert {p.name for p in path.parent.iterdir()} == {"checkpoint.bin", "checkpoint.before.bin"}


@pytest.mark.parametrize(
    "state",
    [
        b'{"a": {"<tensor>": ["float32", [1000000000000]]}}',
        b'{"a": {"<tensor>": ["float32", [1' + b"0" * 400 + b"]]}}",
        b'{"a": {"<tensor>": ["float32", [1.5]]}}',
        b'{"a": {"<tensor>": ["float32", [true]]}}',
        b'{"a": {"<tensor>": ["float32", "12"]}}',
        b'{"a": {"<tensor>": [["float32"], [1]]}}',
        b'{"a": {"<tensor>": {"float32": 1}}}',
        b'{"a": {"<tensor>": ["__import__", [1]]}}',
        b'{"a": ' * 50_000 + b"1" + b"}" * 50_000,
        b'{"a": ' + b"9" * 9000 + b"}",
        b'{"a": "' + b"x" * (2 << 20) + b'"}',
        b"{%s}" % b", ".join(b'"%d": {"<tensor>": ["bool", [0]]}' % k for k in range(2000)),
    ],
    ids=range(12),
)  # fmt: skip
def test_a_header_of_valid_checksum_cannot_do_harm(path: Path, state: bytes) -> None:
    header = b'{"fingerprint": "one", "state": %s}' % state
    prefix = checkpoint.PREFIX.pack(checkpoint.MAGIC, len(header), zlib.crc32(header))
    path.write_bytes(prefix + header + checkpoint.SUM.pack(0))
    assert load_checkpoint(path, "one")["step"] == 0
    path.with_name("checkpoint.before.bin").unlink()
    with pytest.raises(RunFolderError, match=r"damaged|wrong size"):
        load_checkpoint(path, "one")
