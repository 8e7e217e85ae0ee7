"""Contents of photos are found once, remembered, and found again when a file has changed."""

from __future__ import annotations

import errno
import os
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roigs_engine.context import Context
from roigs_engine.errors import Stopped
from roigs_engine.formats.events import Event, Message, StageStarted
from roigs_engine.model.scene import Camera, PosedImage
from roigs_engine.photos import decode
from roigs_engine.photos.contents import UNREAD, read_contents
from roigs_engine.photos.decode import load_photo
from roigs_engine.photos.headers import PhotoError
from roigs_engine.photos.parallel import in_parallel


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
    check = decode.check_whole

    def spy(path: Path) -> str:
        names.append(path.name)
        return check(path)

    monkeypatch.setattr(decode, "check_whole", spy)
    return names


def test_each_photo_is_decoded_once(
    photos: dict[str, Path], decoded: list[str], tmp_path: Path
) -> None:
    memory = tmp_path / "cache/photos.json"
    first = read_contents(photos, memory)
    assert [content.whole for content in first.values()] == [True] * 4 + [False]
    assert len({content.digest for content in first.values()}) == 5
    assert read_contents(photos, memory) == first
    assert sorted(decoded) == sorted(photos)
    assert read_contents(photos) == first  # without a memory: again
    assert len(decoded) == 10


def test_a_touched_photo_keeps_its_digest_and_a_changed_one_does_not(
    photos: dict[str, Path], decoded: list[str], tmp_path: Path
) -> None:
    memory = tmp_path / "photos.json"
    first = read_contents(photos, memory)
    decoded.clear()
    os.utime(photos["0.png"], ns=(1, 1))
    status = photos["1.png"].stat()
    photos["1.png"].write_bytes(
        photos["2.png"].read_bytes().ljust(status.st_size)[: status.st_size]
    )
    os.utime(photos["1.png"], ns=(status.st_atime_ns, status.st_mtime_ns))  # as if unchanged
    second = read_contents(photos, memory)
    assert second["0.png"].digest == first["0.png"].digest
    assert second["1.png"].digest != first["1.png"].digest
    assert sorted(decoded) == ["0.png", "1.png"]


def test_without_decoding_nothing_is_written(
    photos: dict[str, Path], decoded: list[str], tmp_path: Path
) -> None:
    memory = tmp_path / "photos.json"
    found = read_contents(photos, memory, check=False)
    assert decoded == [] and not memory.exists()
    assert {content.whole for content in found.values()} == {None}
    checked = read_contents(photos, memory)
    assert {n: c.digest for n, c in checked.items()} == {n: c.digest for n, c in found.items()}
    assert read_contents(photos, memory, check=False) == checked


def test_values_that_do_not_fill_their_type_are_warned_of(
    photos: dict[str, Path], tmp_path: Path
) -> None:
    """Every time, also when the photos are not decoded again."""
    heard: list[Event] = []
    for name, most in (("0.png", 4095), ("1.png", 16383)):  # of 65535
        grey = np.asarray(Image.open(photos[name])).astype(np.uint16)
        Image.fromarray(grey * (most // 255)).save(photos[name])
    Image.new("L", (40, 30)).save(photos["2.png"])  # black as it is
    for _ in range(2):
        read_contents(photos, tmp_path / "photos.json", Context(emit=heard.append))
    said = [event.text for event in heard if isinstance(event, Message)]
    assert len(said) == 2 and said[0] == said[1]
    assert "2 photos of more than 8 bits" in said[0] and "nearly black: 0.png, 1.png." in said[0]


@pytest.mark.parametrize(
    "text",
    ["", "[]", '{"version": 2}', '{"version": 2, "photos": {"0.png": [1]}}', '{"version": 9}'],
)
def test_a_damaged_memory_is_made_again(
    photos: dict[str, Path], decoded: list[str], tmp_path: Path, text: str
) -> None:
    memory = tmp_path / "photos.json"
    memory.write_text(text)
    found = read_contents(photos, memory)
    assert len(decoded) == 5
    assert read_contents(photos, memory) == found and len(decoded) == 5


def test_a_photo_that_cannot_be_read_is_looked_at_again(tmp_path: Path) -> None:
    memory, path = tmp_path / "photos.json", tmp_path / "a.png"
    assert read_contents({"a": path}, memory) == {"a": UNREAD}
    Image.new("RGB", (20, 20)).save(path)
    assert read_contents({"a": path}, memory)["a"].whole


def test_a_disk_that_fails_once_does_not_damage_a_photo(
    photos: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    memory, check = tmp_path / "photos.json", decode.check_whole

    def failing(path: Path) -> None:
        raise PhotoError("unreadable") from OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(decode, "check_whole", failing)
    assert read_contents(photos, memory)["0.png"].whole is False
    monkeypatch.setattr(decode, "check_whole", check)
    assert read_contents(photos, memory)["0.png"].whole
    assert read_contents(photos, memory)["4.png"].whole is False


def test_after_an_error_no_photo_is_looked_at(tmp_path: Path) -> None:
    seen: list[int] = []

    def work(item: int) -> int:
        time.sleep(0.01)
        seen.append(item)
        if item == 3:
            raise OSError(errno.ENOSPC, "No space left")
        return item

    def read_all() -> None:
        with in_parallel(work, range(100), 1, Context()) as jobs:
            for _, job in jobs:
                job.result()

    with pytest.raises(OSError, match="No space left"):
        read_all()
    count = len(seen)
    time.sleep(0.1)
    assert len(seen) == count < 20


def test_a_stop_keeps_what_was_found(
    photos: dict[str, Path], decoded: list[str], tmp_path: Path
) -> None:
    memory, events = tmp_path / "photos.json", list[Event]()
    context = Context(emit=events.append, should_stop=lambda: len(events) > 2)
    with pytest.raises(Stopped):
        read_contents(photos, memory, context)
    assert isinstance(events[0], StageStarted) and events[0].total == 5
    before = len(decoded)
    assert before >= 2
    read_contents(photos, memory)
    assert len(decoded) <= 5 + before - 2


def test_a_changed_digit_in_the_memory_is_not_believed(
    photos: dict[str, Path], decoded: list[str], tmp_path: Path
) -> None:
    memory = tmp_path / "cache/photos.json"
    first = read_contents(photos, memory)
    digest = first["0.png"].digest
    other = ("1" if digest[0] != "1" else "2") + digest[1:]
    for bad in (other, "é"):
        memory.write_text(memory.read_text("utf-8").replace(digest, bad), encoding="utf-8")
        assert read_contents(photos, memory) == first
    assert len(decoded) == 3 * len(photos)


def test_a_photo_that_changes_while_it_is_used_is_refused(photos: dict[str, Path]) -> None:
    camera = Camera(width=40, height=30, fx=40.0, fy=40.0, cx=20.0, cy=15.0)
    image = PosedImage(
        name="0.png",
        path=photos["0.png"],
        camera=camera,
        world_to_camera=np.eye(4),
        point_indices=np.zeros(0, np.int64),
        file_digest=read_contents(photos)["0.png"].digest,
    )
    assert load_photo(image).shape == (30, 40, 3)
    Image.effect_noise((40, 30), 90).save(image.path)
    with pytest.raises(PhotoError, match="was changed while it was used") as caught:
        load_photo(image)
    assert "--update" in caught.value.hint
