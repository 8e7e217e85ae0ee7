"""Masks of an object on all photos, from strokes on one."""

from __future__ import annotations

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from roigs_engine.context import Context
from roigs_engine.errors import ConfigError, EngineError, Stopped
from roigs_engine.formats.events import Event, Message
from roigs_engine.formats.mask_record import MADE, generated_masks
from roigs_engine.formats.scribbles import BACKGROUND, OBJECT, Stroke

from .scenes import BOX, HEIGHT, WIDTH, BallScene, ball_scene, iou, strokes

pytest.importorskip("cv2")

from roigs_engine.masking import box_masks
from roigs_engine.masking.box_masks import BoxMasks, basis_digest, masked_photos
from roigs_engine.masking.gaussian_votes import GaussianVotes
from roigs_engine.masking.point_votes import PointVotes
from roigs_engine.masking.views import _pieces


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> BallScene:
    return ball_scene(tmp_path_factory.mktemp("ball"))


def work(ball: BallScene, folder: Path, drawn: dict[str, tuple[Stroke, ...]]) -> BoxMasks:
    return BoxMasks(scene=ball.scene, roi=BOX, photos=ball.photos, strokes=drawn, folder=folder)


@pytest.fixture(scope="module")
def scribbled(
    ball: BallScene, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, GaussianVotes, list[str]]:
    """The folder with masks of one photo's strokes, to copy; who voted, and what was made."""
    folder, knowledge = tmp_path_factory.mktemp("made"), votes(ball)
    names = work(ball, folder, {"0.png": strokes(ball.true["0.png"])}).make(knowledge)
    return folder, knowledge, sorted(names)


@pytest.fixture(scope="module")
def made(scribbled: tuple[Path, GaussianVotes, list[str]]) -> Path:
    """The folder of `scribbled`."""
    return scribbled[0]


def votes(ball: BallScene) -> GaussianVotes:
    return GaussianVotes(ball.model, BOX, [BOX])


def masks(folder: Path) -> dict[str, np.ndarray]:
    return {
        p.name.removesuffix(".png"): np.asarray(Image.open(p)) > 0 for p in folder.glob("*.png")
    }


def scores(ball: BallScene, folder: Path) -> list[float]:
    return [iou(mask, ball.true[name]) for name, mask in masks(folder).items()]


def test_one_scribble_gives_the_masks_of_all_photos(
    ball: BallScene, scribbled: tuple[Path, GaussianVotes, list[str]]
) -> None:
    folder, knowledge, names = scribbled
    assert names == [f"{k}.png.png" for k in range(6)]
    assert min(scores(ball, folder)) > 0.9, scores(ball, folder)
    rows = knowledge.rows()
    assert float((rows == ball.ball)[: len(rows)].float().mean()) > 0.95
    assert generated_masks(folder).keys() == set(names)


def test_without_a_model_points_and_colours_carry_the_masks(
    ball: BallScene, tmp_path: Path
) -> None:
    drawn = {"0.png": strokes(ball.true["0.png"])}
    work(ball, tmp_path, drawn).make(PointVotes(ball.scene, BOX))
    assert np.mean(scores(ball, tmp_path)) > 0.85, scores(ball, tmp_path)


def test_the_same_strokes_give_the_same_bytes(ball: BallScene, made: Path, tmp_path: Path) -> None:
    work(ball, tmp_path, {"0.png": strokes(ball.true["0.png"])}).make(votes(ball))
    assert len(list(made.iterdir())) == len(ball.photos) + 1
    for file in made.iterdir():
        assert file.read_bytes() == (tmp_path / file.name).read_bytes()


def test_strokes_win_in_their_own_photo(ball: BallScene, tmp_path: Path) -> None:
    """A correction: the person calls the upper part of the ball background in one photo."""
    true = ball.true["3.png"]
    rows, columns = np.nonzero(true)
    low, middle = float(rows.min()), float(columns.mean())
    line = np.array([[middle - 4, low + 4], [middle + 4, low + 4]])
    drawn = {
        "0.png": strokes(ball.true["0.png"]),
        "3.png": (Stroke(kind=BACKGROUND, width=3.0, points=line),),
    }
    work(ball, tmp_path, drawn).make(votes(ball))
    found = masks(tmp_path)
    assert not found["3.png"][int(low) + 4, int(middle)]
    # The other photos disagree, and so does the rest of that one: the correction stays local.
    assert iou(found["3.png"], true) > 0.8
    assert min(iou(found[name], ball.true[name]) for name in found if name != "3.png") > 0.9
    beside = np.array([[3.0, 3.0], [8.0, 3.0]])  # on the table, far from the box
    drawn["3.png"] = (Stroke(kind=OBJECT, width=3.0, points=beside),)
    work(ball, tmp_path, drawn).make(votes(ball))
    again = masks(tmp_path)
    assert iou(again["3.png"], true) > 0.9 and iou(again["1.png"], ball.true["1.png"]) > 0.9


def test_a_persons_masks_are_used_and_stay(ball: BallScene, tmp_path: Path) -> None:
    drawn = {"0.png": strokes(ball.true["0.png"])}
    own = tmp_path / "2.png.png"
    Image.fromarray(ball.true["2.png"]).save(own)
    before = own.read_bytes()
    made = work(ball, tmp_path, drawn).make(votes(ball))
    assert own.read_bytes() == before and own.name not in made
    # Only a mask, and no stroke at all, is enough.
    made = work(ball, tmp_path, {}).make(votes(ball))
    assert len(made) == 5 and min(scores(ball, tmp_path)) > 0.9
    # A mask that was made and then painted over is the user's, too.
    edited = tmp_path / "4.png.png"
    Image.fromarray(~ball.true["4.png"]).save(edited)
    before = edited.read_bytes()
    assert edited.name not in work(ball, tmp_path, drawn).make(votes(ball))
    assert edited.read_bytes() == before
    assert edited.name not in json.loads((tmp_path / MADE).read_text())["masks"]


def test_masks_of_the_same_inputs_are_kept(ball: BallScene, made: Path, tmp_path: Path) -> None:
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    events: list[Event] = []

    def make(making: BoxMasks) -> tuple[list[str], str]:
        names = making.make(votes(ball), Context(emit=events.append))
        return sorted(names), [event.text for event in events if isinstance(event, Message)][-1]

    drawn = {"0.png": strokes(ball.true["0.png"])}
    every = [f"{k}.png.png" for k in range(6)]
    making = work(ball, tmp_path, drawn)
    before = {path.name: path.read_bytes() for path in tmp_path.glob("*.png")}
    assert make(making) == ([], f"Box 'ball': 0 of 6 masks written to {tmp_path}.")
    line = Stroke(kind=BACKGROUND, width=3.0, points=np.array([[WIDTH / 2, 0.42 * HEIGHT]]))
    corrected = drawn | {"3.png": (line,)}
    making = work(ball, tmp_path, corrected)
    assert make(making) == (["3.png.png"], f"Box 'ball': 1 of 6 masks written to {tmp_path}.")
    after = {path.name: path.read_bytes() for path in tmp_path.glob("*.png")}
    assert [name for name in every if before[name] != after[name]] == ["3.png.png"]
    (tmp_path / "5.png.png").unlink()
    assert make(making)[0] == ["5.png.png"]
    assert iou(masks(tmp_path)["5.png"], ball.true["5.png"]) > 0.9
    Image.fromarray(ball.true["2.png"]).save(tmp_path / "2.png.png")  # a person's now
    assert make(making) == ([], f"Box 'ball': 0 of 5 masks written to {tmp_path}.")
    anew = make(replace(making, anew=True))
    assert anew == (
        sorted({*every} - {"2.png.png"}),
        f"Box 'ball': 5 of 5 masks written to {tmp_path}.",
    )
    # Another model or box, and other strokes to begin with, change all.
    assert len(make(replace(making, basis="another"))[0]) == 5
    begun = corrected | {"1.png": strokes(ball.true["1.png"])}
    assert len(make(replace(making, basis="another", strokes=begun))[0]) == 5


def test_the_model_and_the_boxes_decide_masks(ball: BallScene, tmp_path: Path) -> None:
    model, larger = tmp_path / "model.ply", BOX.scaled(1.1)
    digests = {basis_digest(None, ball.scene, box, [BOX, larger]) for box in (BOX, larger)}
    for data in (b"one", b"two"):
        model.write_bytes(data)
        digests |= {basis_digest(model, ball.scene, BOX, [BOX]) for _ in range(2)}
        digests.add(basis_digest(model, ball.scene, BOX, [BOX, larger]))
    assert len(digests) == 6
    with pytest.raises(EngineError, match="Cannot read"):
        basis_digest(tmp_path / "none.ply", ball.scene, BOX, [BOX])


def test_a_stop_changes_no_mask(ball: BallScene, tmp_path: Path) -> None:
    drawn = {"0.png": strokes(ball.true["0.png"])}
    calls = 0

    def stop() -> bool:
        nonlocal calls
        calls += 1
        return calls > 12

    with pytest.raises(Stopped):
        work(ball, tmp_path, drawn).make(votes(ball), Context(should_stop=stop))
    assert not list(tmp_path.iterdir())


def test_masks_of_a_killed_process_are_made_again(
    ball: BallScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written, write = [], box_masks.atomic_write

    def killed(path: Path, **options: bool) -> Any:
        written.append(path)
        if len(written) == 3:
            raise KeyboardInterrupt
        return write(path, **options)

    monkeypatch.setattr(box_masks, "atomic_write", killed)
    with pytest.raises(KeyboardInterrupt):
        work(ball, tmp_path / "masks", {"0.png": strokes(ball.true["0.png"])}).make(votes(ball))
    monkeypatch.undo()
    half = tmp_path / "masks/.5.png.png.1-00000000.part"
    half.write_bytes(b"")
    assert set(generated_masks(tmp_path / "masks")) == {path.name for path in written[:2]}
    again = work(ball, tmp_path / "masks", {"0.png": strokes(ball.true["0.png"])}).make(votes(ball))
    assert len(again) == len(ball.photos) and not half.exists()


def test_a_mask_that_a_person_saves_meanwhile_stays(ball: BallScene, tmp_path: Path) -> None:
    folder = tmp_path / "masks"
    making = work(ball, folder, {"0.png": strokes(ball.true["0.png"])})
    folder.mkdir()
    own = np.zeros((HEIGHT, WIDTH), dtype=bool)
    calls = iter(range(1000))

    def stop() -> bool:
        if next(calls) == 5:
            Image.fromarray(own).save(folder / "1.png.png")
        return False

    assert "1.png.png" not in making.make(votes(ball), Context(should_stop=stop))
    assert not np.asarray(Image.open(folder / "1.png.png")).any()


@pytest.mark.parametrize("width", [1e-300, 9e5])
def test_strokes_may_have_any_width_and_place(
    ball: BallScene, tmp_path: Path, width: float
) -> None:
    far = Stroke(kind=BACKGROUND, width=width, points=np.array([[-9e5, 9e5], [-8e5, 9e5]]))
    making = work(ball, tmp_path / "masks", {"0.png": (far, *strokes(ball.true["0.png"]))})
    assert len(making.make(votes(ball))) == len(ball.photos)


def test_places_that_the_lens_cannot_show_are_left_out() -> None:
    lost, shown = [np.nan, 0.0], [[1.0, 2.0], [3.0, 4.0]]
    line = np.array([lost, shown[0], lost, lost, *shown, [1e300, 0.0], shown[1]])
    pieces = [piece.tolist() for piece in _pieces(line) if len(piece)]
    assert pieces == [[shown[0]] * 2, shown, [shown[1]] * 2]


def test_nothing_is_made_without_strokes_on_the_box(ball: BallScene, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No stroke lies on box 'ball'"):
        work(ball, tmp_path, {}).make(votes(ball))


def test_strokes_around_the_object_alone_are_refused(ball: BallScene, tmp_path: Path) -> None:
    around = tuple(s for s in strokes(ball.true["0.png"]) if s.kind == BACKGROUND)
    making = work(ball, tmp_path / "masks", {"0.png": around})
    with pytest.raises(ConfigError, match="The object of box 'ball' has no stroke"):
        making.make(votes(ball))
    assert not (tmp_path / "masks").exists()


def test_empty_masks_are_warned_of(ball: BallScene, tmp_path: Path) -> None:
    other = Stroke(kind=BACKGROUND, width=400, points=np.array([[WIDTH / 2, HEIGHT / 2]]))
    drawn = {"0.png": strokes(ball.true["0.png"]), "3.png": (other,)}
    events: list[Event] = []
    making = work(ball, tmp_path / "masks", drawn)
    making.make(votes(ball), Context(emit=events.append))
    said = [event.text for event in events if isinstance(event, Message)]
    assert any("1 mask came out empty: 3.png. Draw on the object there" in text for text in said)


def test_without_opencv_one_line_says_what_to_install(
    ball: BallScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(EngineError) as error:
        work(ball, tmp_path, {"0.png": strokes(ball.true["0.png"])}).make(votes(ball))
    assert "pip install opencv-python-headless" in error.value.hint


def test_which_photos_get_masks() -> None:
    seeing = [str(k) for k in range(9)]
    assert masked_photos(["7", "8"], seeing, ["3"]) == ["3", "7", "8", "0", "1", "2"]
    assert masked_photos(seeing, seeing, ["3"]) == ["3", "0", "1", "2", "4", "5", "6", "7", "8"]


@pytest.mark.parametrize("text", ["mine", "[]", '{"name": "of another program"}'])
def test_a_record_of_another_program_stays(ball: BallScene, tmp_path: Path, text: str) -> None:
    (tmp_path / "made.json").write_text(text)
    wanted = work(ball, tmp_path, {"0.png": strokes(ball.true["0.png"])})
    with pytest.raises(ConfigError, match=r"made\.json would be replaced"):
        wanted.make(PointVotes(ball.scene, BOX))
    assert [path.read_text() for path in tmp_path.iterdir()] == [text]
