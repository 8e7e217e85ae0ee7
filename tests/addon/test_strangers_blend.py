"""A stranger's .blend: odd values are no errors, nothing waits, nothing is written elsewhere.

Panels, views and handlers read it as soon as the file is open.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from roigs_addon.errors import AddonError
from tests.addon.panels import said
from tests.waiting import at_most

pytestmark = pytest.mark.blender
PIPES = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
WAITS = AssertionError("it waits")


@pytest.fixture
def shown(blender: ModuleType, run):
    """A scene with a shown result, and its run folder."""
    blender.ops.roigs.load_results()
    return run


def all_panels(bpy: ModuleType) -> None:
    from roigs_addon.ui import (
        boxes,
        cameras,
        masks,
        result,
        selected,
        stage,
        suggestions,
        surface,
        train,
    )

    panels = boxes, cameras, selected, masks, result, stage, suggestions, surface, train
    for module in panels:
        for cls in vars(module).values():
            own = isinstance(cls, type) and cls.__module__ == module.__name__
            if own and issubclass(cls, bpy.types.Panel) and hasattr(cls, "draw"):
                said(bpy, cls)


def refusal(operator: Callable[[], object]) -> str:
    """The message of an operator that refuses."""
    try:
        operator()
    except RuntimeError as error:
        return str(error)
    return ""


def box(scene: Any) -> Any:
    return next(item for item in scene.objects if item.roigs.kind == "ROI")


def gaussians(scene: Any) -> Any:
    return scene.objects["thing Gaussians"]


# --- nothing waits ---


@PIPES
@pytest.mark.parametrize("name", ["scene.json", "points.npy", "observed_starts.npy"])
def test_panels_do_not_wait_for_a_model_that_is_a_pipe(
    blender: ModuleType, shown, tmp_path: Path, name: str
) -> None:
    from roigs_addon.facts import caches

    scene, _ = shown
    os.mkfifo(tmp_path / name)
    scene.roigs.model_cache = str(tmp_path)
    caches.forget()
    with at_most(20, WAITS):
        all_panels(blender)


@pytest.mark.parametrize(
    "text", ["5", "{}", '{"images": 5}', '{"images": [[1], 2]}', '{"images": [{}]}', "[" * 100_000]
)
def test_panels_read_any_record_of_a_model(
    blender: ModuleType, shown, tmp_path: Path, text: str
) -> None:
    from roigs_addon.facts import caches

    scene, _ = shown
    (tmp_path / "scene.json").write_text(text)
    np.save(tmp_path / "points.npy", np.zeros((3, 2)))
    scene.roigs.model_cache = str(tmp_path)
    caches.forget()
    all_panels(blender)


def test_counts_of_another_model_are_not_used(blender: ModuleType, shown, tmp_path: Path) -> None:
    from roigs_addon.facts import caches, point_counts

    scene, _ = shown
    np.save(tmp_path / "points.npy", np.zeros((3, 3), np.float32))
    np.save(tmp_path / "observed.npy", np.array([0, 99, -5]))
    np.save(tmp_path / "observed_starts.npy", np.array([0, 700]))
    scene.roigs.model_cache = str(tmp_path)
    caches.forget()
    points, photos = point_counts.count(box(scene), scene) or (0, 0)
    assert points and photos is None  # the scene's own points are counted


@PIPES
def test_a_photo_that_is_a_pipe_is_not_opened(blender: ModuleType, shown, tmp_path: Path) -> None:
    from dataclasses import replace

    from roigs_addon.facts import photo_pictures
    from roigs_addon.scene import backgrounds, lookup
    from roigs_addon.viewport import photo_overlay

    scene, _ = shown
    os.mkfifo(tmp_path / "photo")
    camera = lookup.cameras(scene)["photo 1.png"]
    photo = lookup.photo_record(camera)
    assert photo is not None
    camera.roigs.photo = replace(photo, path=str(tmp_path / "photo")).to_json()
    pipe = lookup.photo_record(camera)
    assert pipe is not None
    with at_most(20, WAITS):
        backgrounds.show(camera.data, pipe)
        assert not camera.data.background_images
        assert photo_overlay._pixels(tmp_path / "photo") is None
        assert photo_pictures.icon(scene, photo.name) == 0


FILES = (
    *("manifest.json", "settings.json", "report.json", "split.json", "stages.json", "levels.json"),
    *("run.lock", "rois/thing.surface.json", "rois/thing.glb", "rois/thing.ply", "rois", "coarse"),
    *("coarse/thing.ply", "background.ply", "result.ply", "preview.ply", "earlier", "stages"),
    *("blender", "blender/engine.log", "blender/masks", "blender/suggested/suggestions.html"),
)
"""Of a run folder: files and folders that panels and **Load Results** look at."""


@PIPES
@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=[pytest.mark.slow] if k % 5 else []) for k, n in enumerate(FILES)],
)
def test_something_else_in_the_place_of_a_file(
    blender: ModuleType, shown, tmp_path: Path, name: str
) -> None:
    from roigs_addon.facts import caches

    _, folder = shown
    path, mine = folder / name, tmp_path / "mine"
    mine.mkdir()
    (mine / "result.ply").write_text("mine")
    for put in (
        lambda: os.mkfifo(path),
        lambda: path.symlink_to("/dev/zero"),
        lambda: path.symlink_to(path),
        lambda: path.symlink_to(mine),
        lambda: path.mkdir(),
    ):
        if os.path.lexists(path):
            path.rename(tmp_path / f"before {len([*tmp_path.iterdir()])}")
        path.parent.mkdir(parents=True, exist_ok=True)
        put()
        caches.forget()
        with at_most(40, WAITS):
            all_panels(blender)
            for operator in (blender.ops.roigs.load_results, blender.ops.roigs.clean_up):
                assert "Traceback" not in refusal(operator)
        assert [p.name for p in mine.iterdir()] == ["result.ply"]
        assert (mine / "result.ply").read_text() == "mine"


# --- odd values ---


@pytest.mark.parametrize("name", ["a/b", "/dev/zero", "two\nlines", "nul", "\x1b[31mred"])
def test_any_name_of_a_box(
    blender: ModuleType, shown, name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    from roigs_addon.scene import masks

    scene, folder = shown
    box(scene).name = name
    all_panels(blender)
    assert not masks.are_there(scene, folder) and masks.photos(scene, folder, box(scene)) == []
    with pytest.raises(RuntimeError, match="cannot name a file") as error:
        blender.ops.roigs.train_roi()
    told = str(error.value).strip() + capfd.readouterr().err
    assert "\x1b" not in told and "\n" not in str(error.value).strip()


def test_an_index_below_the_list(blender: ModuleType, shown) -> None:
    scene, _ = shown
    box(scene).roigs.selection.add().name = "photo 1.png"
    box(scene).roigs.selection_index = -5
    all_panels(blender)


@pytest.mark.parametrize("value", [5, "x", [1, 2], [0.0] * 16, [1.0] * 16, [float("nan")] * 16])
def test_any_frame_of_a_mesh(blender: ModuleType, shown, value: Any) -> None:
    from roigs_addon.scene import edits

    scene, _ = shown
    gaussians(scene).data["roigs_frame"] = value
    np.testing.assert_array_equal(edits.frame_of(gaussians(scene)), np.eye(4))
    edits.look_again(gaussians(scene))
    edits.file_of(gaussians(scene))
    assert blender.ops.roigs.load_results() == {"FINISHED"}


@pytest.mark.parametrize(
    "changed",
    [
        {"faults": [[5, {}], ["a", "b", "c"]]},
        {"faults": [["a", "b", "c"], 7]},
        {"known": 1e999},
        {"of": "many"},
        {"exposure_spread": "wide"},
        {"exposure_spread": -1.0},
        {"without_photos": [[], {}]},
        {"made": None},
        {"pixels": -5.0, "known": -1e300, "suggested": 10**30, "without_photos": ["up", "+z"]},
    ],
)
def test_any_check_of_photos(blender: ModuleType, shown, changed: dict[str, object]) -> None:
    from roigs_addon.scene import checked
    from roigs_addon.scene.rois import place_key

    scene, _ = shown
    record = {
        "place": place_key(box(scene), scene),
        "made": "",
        "of": 5,
        "suggested": 2,
    }
    record |= {"pixels": 5, "known": 0.5, "later": 0.6, "without_photos": ["+z"], "faults": []}
    box(scene).roigs.checked = json.dumps(record)
    assert checked.of_box(box(scene)) is not None
    box(scene).roigs.checked = json.dumps(record | changed)
    all_panels(blender)
    assert not checked.is_stale(box(scene), scene)


def test_any_number_of_steps(blender: ModuleType) -> None:
    from roigs_addon.engine.training_steps import training_steps

    for factor in (float("inf"), float("nan"), 1e308, -1.0, 0.0):
        assert 0 < training_steps("draft", "joint", factor, 2) < 1e6


@pytest.mark.parametrize(
    "before",
    [
        '{"film": "x", "compositing": [1], "persistent": null, "shown thing Gaussians": "BAD"}',
        '{"a":' * 50_000,
        "[" * 100_000,
        "x",
    ],
)
def test_any_memory_of_a_stage(blender: ModuleType, shown, before: str) -> None:
    scene, _ = shown
    gaussians(scene).roigs.shown_as = "EXACT"
    film, scene.roigs.stage.before = scene.render.film_transparent, before
    scene.roigs.stage.world = blender.data.worlds.new("without nodes")
    assert blender.ops.roigs.remove_stage() == {"FINISHED"}
    assert scene.render.film_transparent == film
    assert "without nodes" not in blender.data.worlds


def clear_interface(group: Any) -> None:
    group.interface.clear()


def clear_nodes(group: Any) -> None:
    group.nodes.clear()


def other_names(group: Any) -> None:
    for item in group.interface.items_tree:
        item.name = "mine"


def other_images(group: Any) -> None:
    import bpy

    for node in group.nodes:
        if node.type == "IMAGE":
            node.image = bpy.data.images.new("mine", 1, 1)


@pytest.mark.exact_look
@pytest.mark.parametrize("change", [clear_interface, clear_nodes, other_images, other_names])
def test_a_group_of_nodes_that_somebody_has_changed(
    blender: ModuleType, shown, tmp_path: Path, change: Callable[[Any], None]
) -> None:
    from roigs_addon.scene import compositor, shadow_pass

    scene, _ = shown
    change(compositor.find(scene))
    paths = [image.filepath for image in blender.data.images if image.name == "mine"]
    compositor.point_to(scene, tmp_path / "out")
    compositor.reload(scene)
    shadow_pass.connect(scene)
    shadow_pass.disconnect(scene)
    assert paths == [i.filepath for i in blender.data.images if i.name == "mine"]


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(("name", value) for value in ("\ud800", "caf\udce9.png")),
        *(("fx", value) for value in (10**400, float("nan"), 0.0, "x")),
        *(("width", value) for value in (0, -1, 10**400, None)),
        *(
            ("world_to_camera", value)
            for value in ([], [[1.0]], [[float("inf")] * 4] * 4, [[1.0] * 4] * 4)
        ),
    ],
)
def test_cameras_that_are_none(blender: ModuleType, shown, key: str, value: Any) -> None:
    from roigs_addon.scene import lookup

    scene, _ = shown
    camera = lookup.cameras(scene)["photo 1.png"]
    camera.roigs.photo = json.dumps(json.loads(camera.roigs.photo) | {key: value})
    assert lookup.photo_record(camera) is None
    camera.roigs.kind, camera.roigs.suggestion = "SHOT", '{"box": "a", "number": 1e999}'
    all_panels(blender)


@pytest.mark.parametrize("lens", ["x", "A B C", "OPENCV 1", "OPENCV -5 0 1", "OPENCV 1e3 2"])
def test_a_lens_of_other_words(blender: ModuleType, shown, lens: str) -> None:
    from roigs_addon.scene import lookup, masks

    scene, _ = shown
    camera = lookup.cameras(scene)["photo 1.png"]
    camera.roigs.photo = json.dumps(json.loads(camera.roigs.photo) | {"lens": lens})
    photo = lookup.photo_record(camera)
    assert photo is not None and masks.size_of(photo) == (64, 48)


@pytest.mark.parametrize(
    "surface",
    [
        '{"size": "abc", "volume": "x", "filled": {}, "watertight": 1}',
        '{"size": [1, "x", null, 1e400], "volume": 1e999, "filled": [1]}',
        '{"size": 5, "volume": ' + "9" * 5000 + "}",
        "[" * 100_000,
        "[]",
        "",
    ],
)
def test_any_facts_of_a_mesh(blender: ModuleType, shown, surface: str) -> None:
    from roigs_addon.ui.surface import facts

    scene, _ = shown
    blender.ops.mesh.primitive_cube_add()
    item = blender.context.object
    item.roigs.kind, item.roigs.roi, item.roigs.surface = "SURFACE", "thing", surface
    assert facts(scene, item).startswith("6 faces")


def test_texts_are_shown_in_part_and_without_controls(blender: ModuleType, addon) -> None:
    from roigs_addon.ui import layout
    from tests.addon.panels import Layout

    lines: list[str] = []
    layout.wrapped(Layout(lines), "a\x1b[31m \ud800 b\u202e " + 10**6 * "word ", "INFO", 40)
    assert len(lines) < 80 and " ".join(lines).endswith("…")
    assert lines[0].startswith("a\\x1b[31m \\ud800 b\\u202e word")


def test_choices_of_another_version(blender: ModuleType, shown) -> None:
    scene, _ = shown
    raw = scene.get("roigs")
    if raw is None:  # Blender 5 keeps what add-ons add out of reach of scripts
        pytest.skip("the values cannot be written")
    for name in ("made_for", "preset", "strategy", "method"):
        raw[name] = 99
    assert scene.roigs.preset == ""
    all_panels(blender)


@pytest.mark.parametrize("name", ["scale", "rotation", "radiance:base", "radiance:sh_0"])
@pytest.mark.parametrize("kind", ["FLOAT", "FLOAT2", "FLOAT_VECTOR", "FLOAT_COLOR", "STRING"])
def test_attributes_of_another_kind(blender: ModuleType, shown, name: str, kind: Any) -> None:
    from roigs_addon.scene import point_edits, splat_attributes

    scene, _ = shown
    mesh = gaussians(scene).data
    mesh.attributes.remove(mesh.attributes[name])
    mesh.attributes.new(name, kind, "POINT")
    splat_attributes.cloud_of(mesh)
    with suppress(AddonError):
        point_edits.opacities(gaussians(scene))
    assert splat_attributes.drawn(mesh).shape == (len(mesh.vertices),)


@pytest.mark.parametrize("scale", [0.0, float("nan")])
def test_a_root_that_stands_nowhere(blender: ModuleType, shown, scale: float) -> None:
    scene, _ = shown
    scene.roigs.root.scale = (scale,) * 3
    blender.context.view_layer.update()
    for name in ("set_floor", "find_floaters", "light_from_scene", "suggest_photos"):
        operator = getattr(blender.ops.roigs, name)
        if operator.poll():
            with pytest.raises(RuntimeError) as error:
                operator()
            assert "Traceback" not in str(error.value)


def test_the_size_of_any_folder_is_not_added_up(blender: ModuleType, shown, tmp_path: Path) -> None:
    """The author of the .blend may have named `/` as its run folder."""
    from roigs_addon.facts import run_facts

    scene, folder = shown
    before = run_facts.disk(scene).total
    (folder / "mine").mkdir()
    (folder / "mine" / "film.mov").write_bytes(bytes(10**6))
    assert run_facts.disk(scene).total == before > 0


# --- nothing is written elsewhere ---


@pytest.mark.skipif(os.name == "nt", reason="paths of POSIX")
@pytest.mark.parametrize("folder", ["null", "C:\\runs\\mine", "../run", "~"])
def test_a_run_folder_of_another_system_is_not_made_here(
    blender: ModuleType,
    shown,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    folder: str,
) -> None:
    scene, _ = shown
    here = tmp_path / "a" / "here"
    here.mkdir(parents=True)
    monkeypatch.chdir(here)
    scene.roigs.run_dir = folder
    with pytest.raises(RuntimeError, match="is not a full path on this computer"):
        blender.ops.roigs.train_roi()
    assert not [*here.iterdir()] and [*here.parent.iterdir()] == [here]


def test_the_log_is_not_written_through_a_link(
    blender: ModuleType, shown, tmp_path: Path, engine: object
) -> None:
    from roigs_addon.jobs import current
    from roigs_addon.jobs.spec import LEVELS, JobSpec

    _, folder = shown
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "engine.log").write_text("mine")
    (folder / "blender").symlink_to(mine)
    log = folder / "blender" / "engine.log"
    with pytest.raises(Exception, match="is a link; nothing is written through links"):
        current.start(engine, JobSpec(title=LEVELS, arguments=["levels", str(folder)], log=log))
    assert (mine / "engine.log").read_text() == "mine" and len([*mine.iterdir()]) == 1


def test_a_page_that_is_a_link_is_not_opened(blender: ModuleType, shown, tmp_path: Path) -> None:
    from roigs_addon.jobs import suggest_job

    scene, folder = shown
    page = folder / "blender" / "suggested" / "suggestions.html"
    page.parent.mkdir(parents=True)
    page.write_text("a page")
    assert suggest_job.page(scene) == page
    page.unlink()
    (tmp_path / "program.command").write_text("#!/bin/sh\n")
    page.symlink_to(tmp_path / "program.command")
    assert suggest_job.page(scene) is None
    assert not blender.ops.roigs.open_suggestions.poll()


def test_a_result_in_another_folder_is_not_deleted(blender: ModuleType, shown) -> None:
    from tests.addon.results import set_aside

    _, folder = shown
    mine = set_aside(folder)
    elsewhere = folder.with_name("mine")
    (folder / "earlier").rename(elsewhere)
    (folder / "earlier").symlink_to(elsewhere)
    with pytest.raises(RuntimeError, match="is a link"):
        blender.ops.roigs.delete_result(earlier=mine.name)
    assert (elsewhere / mine.name / "result.ply").is_file()


def test_images_are_opened_in_one_place() -> None:
    """`blender.load_image` looks first whether a file can be opened without waiting."""
    from tests.addon.scenes import ROOT

    callers = [
        path.name
        for path in sorted((ROOT / "roigs_addon").rglob("*.py"))
        if "images.load(" in path.read_text(encoding="utf-8")
    ]
    assert callers == ["blender.py"]
