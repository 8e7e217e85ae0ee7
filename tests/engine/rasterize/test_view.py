"""Pictures of a model and of camera paths."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from roigs_engine.context import Context
from roigs_engine.errors import ConfigError, Stopped
from roigs_engine.formats.events import Event, Preview, Progress, StageStarted, to_json
from roigs_engine.formats.names import safe_name
from roigs_engine.model.gaussians import SH_C0, Gaussians
from roigs_engine.model.scene import Camera
from roigs_engine.rasterize import rasterize
from roigs_engine.rasterize import view as view_module
from roigs_engine.rasterize.camera_path import load_camera_path
from roigs_engine.rasterize.image_files import render_sequence, to_uint8
from roigs_engine.rasterize.view import render_view

CAMERA = Camera(width=40, height=30, fx=50.0, fy=50.0, cx=20.0, cy=15.0)
RECORD = {
    "name": "0001",
    "width": 40,
    "height": 30,
    "fx": 50.0,
    "fy": 50,
    "cx": 20.0,
    "cy": 15.0,
    "world_to_camera": np.eye(4).tolist(),
}


@pytest.fixture(autouse=True)
def _reference(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(view_module, "rasterize", partial(rasterize, backend="reference"))


def one_gaussian(colour: tuple[float, float, float] = (0.9, 0.5, 0.1)) -> Gaussians:
    """An opaque ball that projects to (30.5, 10.5): the centre of column 30, row 10."""
    arrays = {
        "means": np.array([[0.42, -0.18, 2.0]]),
        "quats": np.array([[1.0, 0, 0, 0]]),
        "log_scales": np.full((1, 3), np.log(0.05)),
        "logit_opacities": np.array([8.0]),
        "sh": (np.array(colour)[None, None] - 0.5) / SH_C0,
    }
    return Gaussians.from_arrays({name: a.astype(np.float32) for name, a in arrays.items()})


def path_file(folder: Path, document: Any) -> Path:
    path = folder / "path.json"
    text = document if isinstance(document, str) else json.dumps(document)
    path.write_text(text, encoding="utf-8")
    return path


def test_view_shows_the_gaussian_where_it_projects() -> None:
    view = render_view(one_gaussian(), CAMERA, np.eye(4), with_depth=True)
    assert view.image.shape == (30, 40, 3)
    assert view.image.dtype == torch.float32
    assert divmod(int(view.image.sum(dim=-1).argmax()), 40) == (10, 30)
    assert view.image[10, 30].tolist() == pytest.approx([0.9, 0.5, 0.1], abs=0.01)
    assert torch.allclose(view.image[10, 29], view.image[10, 31], atol=1e-3)
    assert torch.allclose(view.image[9, 30], view.image[11, 30], atol=1e-3)
    assert view.depth is not None
    assert float(view.depth[10, 30]) == pytest.approx(2.0, abs=1e-4)
    assert float(view.depth[0, 0]) == 0


def test_values_are_clamped_and_carry_no_gradient() -> None:
    model = one_gaussian((4.0, 4.0, 4.0))
    model.means.requires_grad_(True)
    view = render_view(model, CAMERA, np.eye(4), background=torch.ones(3))
    assert view.depth is None
    assert not view.image.requires_grad
    assert float(view.image.max()) == 1.0
    assert view.image[0, 0].tolist() == [1, 1, 1]


def test_sequence_writes_every_camera(tmp_path: Path) -> None:
    names = ["0001", "widok/2", "żółw"]
    document = {"cameras": [{**RECORD, "name": name} for name in names]}
    cameras = load_camera_path(path_file(tmp_path, document))
    assert [name for name, _, _ in cameras] == names
    assert cameras[0][1] == CAMERA
    events: list[Event] = []
    out = tmp_path / "out put"
    written = render_sequence(one_gaussian(), cameras, out, Context(emit=events.append))
    assert sorted(out.iterdir()) == sorted(written)
    assert [path.name for path in written][::2] == ["0001.png", "żółw.png"]
    assert events[0] == StageStarted(stage="render", total=3)
    assert events[1::2] == [Preview(path=str(path)) for path in written]
    steps = [event.step for event in events[2::2] if isinstance(event, Progress)]
    assert steps == [1, 2, 3]
    json.loads(to_json(events[2]), parse_constant=pytest.fail)
    expected = to_uint8(render_view(one_gaussian(), CAMERA, np.eye(4)).image)
    assert np.array_equal(np.asarray(Image.open(written[1])), expected)


def test_a_sequence_stops_between_two_pictures(tmp_path: Path) -> None:
    cameras = load_camera_path(
        path_file(tmp_path, {"cameras": [{**RECORD, "name": name} for name in "abc"]})
    )
    events: list[Event] = []
    with pytest.raises(Stopped):
        render_sequence(
            one_gaussian(),
            cameras,
            tmp_path / "out",
            Context(emit=events.append, should_stop=lambda: len(events) > 1),
        )
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["a.png"]


@pytest.mark.parametrize(
    "document",
    [
        "no json",
        "[]",
        {},
        {"cameras": []},
        {"cameras": [3]},
        {"cameras": [{**RECORD, "name": ""}]},
        {"cameras": [{**RECORD, "name": 7}]},
        {"cameras": [{key: value for key, value in RECORD.items() if key != "fx"}]},
        {"cameras": [{**RECORD, "width": 0}]},
        {"cameras": [{**RECORD, "width": 40.5}]},
        {"cameras": [{**RECORD, "height": True}]},
        {"cameras": [{**RECORD, "fx": -1}]},
        {"cameras": [{**RECORD, "fy": "wide"}]},
        {"cameras": [{**RECORD, "cx": float("nan")}]},
        {"cameras": [{**RECORD, "cx": 10**400}]},
        {"cameras": [{**RECORD, "world_to_camera": [[1, 0], [0, 1]]}]},
        {"cameras": [{**RECORD, "world_to_camera": [[1, 0, 0, 0], [0]]}]},
        {"cameras": [{**RECORD, "world_to_camera": (2 * np.eye(4)).tolist()}]},
        {"cameras": [{**RECORD, "world_to_camera": np.diag([1.0, 1, -1, 1]).tolist()}]},
        {"cameras": [RECORD, RECORD]},
    ],
)
def test_malformed_path_is_one_line(tmp_path: Path, document: Any) -> None:
    path = path_file(tmp_path, document)
    with pytest.raises(ConfigError) as caught:
        load_camera_path(path)
    assert "\n" not in str(caught.value)
    assert "path.json" in str(caught.value)


def test_missing_path_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError):
        load_camera_path(tmp_path / "none.json")


@given(st.text('aZ0 ._-/\\:*?"<>|\n\0é漢😀', max_size=200))
def test_safe_names_are_one_plain_component(name: str) -> None:
    safe = safe_name(name)
    assert safe
    assert Path(safe).name == safe
    assert not set(safe) & set('/\\:*?"<>|\n\0')
    assert len(safe) <= 87
    assert safe == safe.strip(" .")
    assert safe_name(safe) == safe


def test_safe_names_stay_different() -> None:
    names = ["a/b", "a_b", "a\\b", "a:b", " a_b", "żółw", ".."]
    assert len({safe_name(name) for name in names}) == len(names)
    assert safe_name("IMG 01-a.jpg") == "IMG 01-a.jpg"
