"""Confidence of Gaussians in Blender: measured, kept, a heat map, a limit to clean up."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from roigs_engine.formats.confidence import colours, most_directions
from roigs_engine.formats.splat_ply import SH_C0, read_ply
from tests.addon.fake_engine import in_edit_mode, use
from tests.addon.panels import said

pytestmark = pytest.mark.blender

ANSWER = """
import numpy as np
given = dict(word[2:].split("=", 1) for word in sys.argv if word.startswith("--") and "=" in word)
models = json.load(open(given["model"]))["models"]
def rows(path):
    head = open(path, "rb").read(2000).decode("latin-1")
    return int(head.split("element vertex ")[1].split()[0])
count = sum(rows(model["ply"]) for model in models)
every = np.stack([np.arange(count) + 5, np.arange(count), np.full(count, 0.25)], axis=1)
np.save(given["out"], every.astype(np.float32))
say(event="done", outputs={}, stopped=False)
"""


@pytest.fixture
def item(blender: ModuleType, run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The background of a result, selected, with its third point hidden; the engine is fake."""
    blender.ops.roigs.load_results()
    use(monkeypatch, tmp_path, ANSWER)
    blender.ops.roigs.select_gaussians(name="Background")
    found = run[0].objects["Background"]
    hide = np.zeros(len(found.data.vertices), bool)
    hide[2] = True
    found.data.vertices.foreach_set("hide", hide)
    return found


def directions(item) -> np.ndarray:
    from roigs_addon.scene import heat_map

    found = heat_map.directions(item)
    assert found is not None
    return found


def drawn_colours(item) -> np.ndarray:
    """Colours in the viewport, as sRGB."""
    from roigs_addon.viewport import objects

    (one,) = objects.marked([item])
    return 0.5 + SH_C0 * read_ply(one.file.path)["sh"][:, 0]


def test_the_answer_is_kept_and_shown(blender: ModuleType, item) -> None:
    from roigs_addon.scene import display

    display.show_as(item, "EXACT")
    own = drawn_colours(item)
    assert blender.ops.roigs.find_confidence() == {"FINISHED"}
    found = directions(item)
    assert np.isnan(found[2])
    known = np.delete(found, 2)
    np.testing.assert_array_equal(known, np.arange(len(known)) + known[0])
    hot = colours(known, most_directions(known))
    np.testing.assert_allclose(drawn_colours(item), hot, atol=1e-5)
    blender.ops.roigs.show_heat_map()
    np.testing.assert_allclose(drawn_colours(item), own, atol=1e-5)
    blender.ops.roigs.show_heat_map()
    np.testing.assert_allclose(drawn_colours(item), hot, atol=1e-5)
    assert blender.ops.roigs.find_confidence() == {"FINISHED"}  # again: no second attribute
    assert [a.name for a in item.data.attributes if a.name.startswith("directions")] == [
        "directions"
    ]


def test_an_object_in_edit_mode(blender: ModuleType, item) -> None:
    from roigs_addon.jobs import confidence_job
    from roigs_addon.operators import confidence

    said = in_edit_mode(item, confidence_job.spec(blender.context, confidence._take))
    assert said.endswith("Gaussians are seen from fewer than 3 directions")
    assert np.isfinite(directions(item)).sum() == len(item.data.vertices) - 1


def test_few_directions_are_deleted_and_the_map_follows(blender: ModuleType, item) -> None:
    blender.ops.roigs.find_confidence()
    before = directions(item)
    fewer = int(np.nanmin(before)) + 4
    assert blender.ops.roigs.choose_by_directions(fewer=fewer, action="DELETE") == {"FINISHED"}
    stay = before[~(before < fewer)]
    np.testing.assert_array_equal(directions(item), stay)
    blender.context.view_layer.update()
    known = stay[np.isfinite(stay)]
    hot = colours(known, most_directions(before))
    np.testing.assert_allclose(drawn_colours(item), hot, atol=1e-5)


def test_it_is_saved(blender: ModuleType, item, tmp_path: Path) -> None:
    from roigs_addon.scene import heat_map

    blender.ops.roigs.find_confidence()
    before = directions(item)
    blender.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    blender.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    again = blender.context.scene.objects["Background"]
    assert heat_map.most() is None
    np.testing.assert_array_equal(directions(again), before)


def test_before_anybody_asked(blender: ModuleType, item) -> None:
    from roigs_addon.ui.clean_up import CleanUpPanel

    assert not blender.ops.roigs.show_heat_map.poll()
    with pytest.raises(RuntimeError, match="Click Find Confidence"):
        blender.ops.roigs.choose_by_directions(action="SELECT")
    assert "Few directions" not in said(blender, CleanUpPanel)
    blender.ops.roigs.find_confidence()
    labels = said(blender, CleanUpPanel)
    assert "Few directions" in labels and any("Blue: few directions" in text for text in labels)


def test_changed_meanwhile(blender: ModuleType, item) -> None:
    from roigs_addon.errors import AddonError
    from roigs_addon.jobs import confidence_job

    taken: list[object] = []
    spec = confidence_job.spec(blender.context, lambda known: str(taken.append(known)))
    item.data.vertices[0].co.x += 1
    np.save(Path(blender.app.tempdir) / "roigs-confidence.npy", np.zeros((9, 3), np.float32))
    with pytest.raises(AddonError, match=r"changed meanwhile\. Find confidence again"):
        spec.on_done()
    assert not taken


@pytest.mark.parametrize("then", ["hidden", "renamed", "opened", "chosen by the user"])
def test_native_splats_are_drawn_by_us_meanwhile(
    blender: ModuleType, item, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, then: str
) -> None:
    from roigs_addon.scene import display, heat_map

    monkeypatch.setattr(display, "is_native", lambda i, **_: i.roigs.shown_as == "GAUSSIANS")
    monkeypatch.setattr(display, "refresh", lambda _: None)
    item.roigs.shown_as = "GAUSSIANS"
    blender.ops.roigs.find_confidence()
    assert item.roigs.shown_as == "EXACT"
    if then == "renamed":
        item.name = "Room"
    elif then == "chosen by the user":
        display.show_as(item, "EXACT")
    if then == "opened":
        blender.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
        blender.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
        item = blender.context.scene.objects["Background"]
    else:
        heat_map.hide()
    assert item.roigs.shown_as == ("EXACT" if then == "chosen by the user" else "GAUSSIANS")
