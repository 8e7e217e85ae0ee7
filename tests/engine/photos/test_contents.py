"""What photos hold is found once, remembered, and found again when a file has changed."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from PIL import Image

from roigs_engine.context import Context
from roigs_engine.errors import Stopped
from roigs_engine.formats.events import Event, StageStarted
from roigs_engine.photos import damage
from roigs_engine.photos.contents import Content, Contents


@pytest.fixture
def photos(tmp_path: Path) -> dict[str, Path]:
    """Five photos, the last one damaged."""
    paths = {f"{k}.png": tmp_path / f"{k}.png" for k in range(5)}
    for k, path in enumerate(paths.values()):
        Image.effect_noise((40, 30), 20 + k).save(path)
    paths["4.png"].write_bytes(paths["4.png"].read_bytes()[:-100])
    return paths


@pytest.fixture
def decoded(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the photos as they are decoded."""
    names: list[str] = []
    check = damage.check_whole

    def spy(path: Path) -> None:
        names.append(path.name)
        check(path)

    monkeypatch.setattr(damage, "check_whole", spy)
    return names


def test_each_photo_is_decoded_once(
    photos: dict[str, Path], decoded: list[str], tmp_path: Path
) -> None:
    memory = tmp_path / "cache/photos.json"
    first = Contents(memory).read(photos)
    assert [content.whole for content in first.values()] == [True] * 4 + [False]
    assert len({content.digest for content in first.values()}) == 5
    assert Contents(memory).read(photos) == first
    assert sorted(decoded) == sorted(photos)
    assert Contents().read(photos) == first  # without a memory: again
    assert len(decoded) == 10


def test_a_touched_photo_keeps_its_digest_and_a_changed_one_does_not(
    photos: dict[str, Path], decoded: list[str], tmp_path: Path
) -> None:
    memory = tmp_path / "photos.json"
    first = Contents(memory).read(photos)
    decoded.clear()
    os.utime(photos["0.png"], ns=(1, 1))
    status = photos["1.png"].stat()
    photos["1.png"].write_bytes(
        photos["2.png"].read_bytes().ljust(status.st_size)[: status.st_size]
    )
    os.utime(photos["1.png"], ns=(status.st_atime_ns, status.st_mtime_ns))  # as if unchanged
    second = Contents(memory).read(photos)
    assert second["0.png"].digest == first["0.png"].digest
    assert second["1.png"].digest != first["1.png"].digest
    assert sorted(decoded) == ["0.png", "1.png"]


def test_without_decoding_nothing_is_written(
    photos: dict[str, Path], decoded: list[str], tmp_path: Path
) -> None:
    memory = tmp_path / "photos.json"
    found = Contents(memory).read(photos, check=False)
    assert decoded == [] and not memory.exists()
    assert {content.whole for content in found.values()} == {None}
    checked = Contents(memory).read(photos)
    assert {n: c.digest for n, c in checked.items()} == {n: c.digest for n, c in found.items()}
    assert Contents(memory).read(photos, check=False) == checked


@pytest.mark.parametrize(
    "text",
    ["", "[]", '{"version": 1}', '{"version": 1, "photos": {"0.png": [1]}}', '{"version": 9}'],
)
def test_a_damaged_memory_is_made_again(
    photos: dict[str, Path], decoded: list[str], tmp_path: Path, text: str
) -> None:
    memory = tmp_path / "photos.json"
    memory.write_text(text)
    found = Contents(memory).read(photos)
    assert len(decoded) == 5
    assert Contents(memory).read(photos) == found and len(decoded) == 5


def test_a_photo_that_cannot_be_read_is_looked_at_again(tmp_path: Path) -> None:
    memory, path = tmp_path / "photos.json", tmp_path / "a.png"
    lost = Content(size=0, modified=0, changed=0, whole=False)
    assert Contents(memory).read({"a": path}) == {"a": lost}
    Image.new("RGB", (20, 20)).save(path)
    assert Contents(memory).read({"a": path})["a"].whole


def test_a_stop_keeps_what_was_found(
    photos: dict[str, Path], decoded: list[str], tmp_path: Path
) -> None:
    memory, events = tmp_path / "photos.json", list[Event]()
    context = Context(emit=events.append, should_stop=lambda: len(events) > 2)
    with pytest.raises(Stopped):
        Contents(memory).read(photos, context)
    assert isinstance(events[0], StageStarted) and events[0].total == 5
    before = len(decoded)
    assert before >= 2
    Contents(memory).read(photos)
    assert len(decoded) <= 5 + before - 2
