"""The content of the panels."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import pytest

from tests.addon.panels import Layout, said

pytestmark = pytest.mark.blender


def test_what_is_drawn_from_the_blend_is_said(blender: ModuleType, run) -> None:
    from roigs_addon.facts import run_facts
    from roigs_addon.ui.result import ResultPanel

    scene, folder = run
    blender.ops.roigs.load_results()
    assert run_facts.lost_splats(scene) == []
    moved = folder.rename(folder.with_name("moved"))
    assert run_facts.lost_splats(scene) == ["Background", "thing Gaussians", "thing first pass"]
    told = " ".join(said(blender, ResultPanel))
    assert "3 models are drawn from the .blend" in told
    scene.roigs.run_dir = str(moved)
    blender.ops.roigs.load_results()
    assert run_facts.lost_splats(scene) == []


@pytest.mark.exact_look
def test_what_renders_lack_is_said(blender: ModuleType, run) -> None:
    from roigs_addon.scene import compositor
    from roigs_addon.ui.result import ResultPanel

    scene, _ = run
    blender.ops.roigs.load_results()
    scene.view_settings.view_transform = "AgX"
    assert "choose the Standard view transform" in " ".join(said(blender, ResultPanel))
    scene.view_settings.view_transform = "Standard"
    texts = said(blender, ResultPanel)
    assert not any("view transform" in text or "Renders lack" in text for text in texts)
    scene.render.use_compositing = False
    assert any("Switch on" in text for text in said(blender, ResultPanel))
    scene.render.use_compositing = True
    blender.data.node_groups.remove(compositor.find(scene))
    assert any("Renders lack" in text for text in said(blender, ResultPanel))
    blender.ops.roigs.load_results()
    assert compositor.find(scene)
    (tree,) = compositor.trees(scene)
    (end,) = (node for node in tree.nodes if node.type in compositor.ENDS)
    assert end.inputs[0].links[0].from_node.node_tree == compositor.find(scene)


def test_panels_draw(blender: ModuleType, run) -> None:
    """Every panel's `draw`, on a layout that accepts everything."""
    from roigs_addon.jobs import current
    from roigs_addon.ui import (
        boxes,
        cameras,
        levels,
        look,
        placement,
        reconstruct,
        result,
        scene,
        selected,
        train,
    )

    panels = (
        *(reconstruct.PhotosPanel, reconstruct.PhotosOptionsPanel),
        *(placement.PlacementPanel, look.LookPanel, levels.LevelsPanel),
        *(scene.ScenePanel, boxes.BoxesPanel, boxes.PlacePanel, cameras.CamerasPanel),
        *(selected.SelectedPanel, train.TrainPanel, train.TrainSettingsPanel, result.ResultPanel),
    )

    def draw_all() -> None:
        for cls in panels:
            if not hasattr(cls, "poll") or cls.poll(blender.context):
                said(blender, cls)

    draw_all()
    blender.ops.roigs.select_cameras()
    blender.ops.roigs.load_results()
    blender.ops.roigs.look_through(photo="photo 0.png")
    draw_all()
    current.state().error = "Something is wrong. " * 9
    draw_all()
    blender.ops.roigs.remove_roi()
    draw_all()


def test_the_look_is_that_of_gaussians(blender: ModuleType, run) -> None:
    from roigs_addon.ui.look import LookPanel

    blender.ops.roigs.load_results()
    for name, shown in (("thing", False), ("Background", True), ("photo 3.png", False)):
        blender.context.view_layer.objects.active = run[0].objects[name]
        assert LookPanel.poll(blender.context) == shown
    blender.context.view_layer.objects.active = run[0].objects["Background"]
    assert said(blender, LookPanel) == ["Background"]
    blender.ops.roigs.show_as(way="POINTS")
    assert not LookPanel.poll(blender.context)


def test_the_look_takes_the_exposure_of_a_photo(blender: ModuleType, run) -> None:
    """That of the photo that the scene looks through, as training found it."""
    from roigs_addon.ui.look import LookPanel

    scene, folder = run[0], run[1]
    blender.ops.roigs.load_results()
    found = folder / "cache" / "exposures.json"
    found.parent.mkdir(exist_ok=True)
    found.write_text(json.dumps({"key": "", "stops": {"photo 0.png": 1.1, "photo 1.png": -0.44}}))
    blender.ops.roigs.look_through(photo="photo 2.png")
    item = scene.objects["Background"]
    blender.context.view_layer.objects.active = item
    assert said(blender, LookPanel) == ["Background", "Photos: -0.4 to +1.1 stops"]
    blender.ops.roigs.look_through(photo="photo 0.png")
    blender.context.view_layer.objects.active = item
    assert said(blender, LookPanel)[-1] == "As in photo 0 (+1.1 stops)"
    blender.ops.roigs.exposure_of_photo(photo="photo 0.png")
    assert item.roigs.exposure == pytest.approx(0.5)  # sRGB values grow less than the light
    with pytest.raises(RuntimeError, match=r"photo 2\.png"):
        blender.ops.roigs.exposure_of_photo(photo="photo 2.png")
    blender.context.view_layer.objects.active = scene.objects["photo 0.png"]
    assert not blender.ops.roigs.exposure_of_photo.poll()


@pytest.mark.parametrize(
    "stops", ["[1]", '{"a": "1"}', '{"a": NaN, "b": 1e999, "c": 1e99}', "3", "null"]
)
def test_exposures_that_are_none(blender: ModuleType, run, stops: str) -> None:
    from roigs_addon.facts import run_facts

    found = run[1] / "cache" / "exposures.json"
    found.parent.mkdir(exist_ok=True)
    found.write_text(f'{{"key": "", "stops": {stops}}}')
    assert run_facts.result(run[0]).exposures == {}


def test_folders_that_cannot_be_looked_at(blender: ModuleType, run, tmp_path: Path) -> None:
    """Such as another user's; here, because their names are too long."""
    from roigs_addon.ui.result import ResultPanel
    from roigs_addon.ui.train import TrainPanel

    scene, strange = run[0], str(tmp_path / ("x" * 300))
    scene.roigs.run_dir = strange
    for panel in (TrainPanel, ResultPanel):
        said(blender, panel)
    assert not blender.ops.roigs.load_results.poll() and not blender.ops.roigs.clean_up.poll()
    with pytest.raises(RuntimeError, match="There is no folder") as failed:
        blender.ops.roigs.import_colmap(directory=strange)
    assert "Traceback" not in str(failed.value)
    with pytest.raises(RuntimeError, match="There is no file") as failed:
        blender.ops.roigs.load_rois(filepath=strange)
    assert "Traceback" not in str(failed.value)
    from roigs_addon.engine import environments

    assert environments.made([Path(strange)]) == []


def test_a_missing_file_is_no_problem(
    blender: ModuleType, run, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon import viewport
    from roigs_addon.ui.result import ResultPanel

    blender.ops.roigs.load_results()
    there, gone = (str(run[1] / name) for name in ("result.ply", "gone.ply"))
    problems = {there: "it is damaged", gone: f"There is no file {gone}"}
    monkeypatch.setattr(viewport, "problems", lambda: problems)
    text = " ".join(said(blender, ResultPanel))
    assert "it is damaged" in text and "gone.ply" not in text


def test_skipped_photos_are_said_once(
    blender: ModuleType, addon: ModuleType, tmp_path: Path
) -> None:
    from roigs_addon.jobs import current
    from roigs_addon.ui.scene import ScenePanel
    from tests.addon.colmap_project import write_project
    from tests.addon.scenes import imported

    folder = write_project(tmp_path / "garden")
    (folder / "images" / "photo 3.png").unlink()
    imported(blender, folder)
    for words in ("Skipped 1 photo", "1 photo left out: missing on disk"):
        text = " ".join(said(blender, ScenePanel))  # first the import's own warning
        assert words in text and text.count("missing on disk") == 1
        current.job = None


def test_what_a_job_said_is_gone_with_its_file(blender: ModuleType, run) -> None:
    from roigs_addon.jobs import current
    from roigs_addon.ui.scene import ScenePanel

    current.state().error = "Something is wrong."
    assert any("Something is wrong." in text for text in said(blender, ScenePanel))
    blender.ops.wm.read_homefile(use_empty=True)
    assert current.state().title == ""
    assert not any("Something is wrong." in text for text in said(blender, ScenePanel))


def test_a_box_without_a_model_is_not_called_empty(blender: ModuleType, addon: ModuleType) -> None:
    from roigs_addon.ui.boxes import BoxesPanel

    blender.ops.roigs.add_roi()
    blender.context.view_layer.update()
    assert not any("Empty" in text for text in said(blender, BoxesPanel))


def test_psnr_of_other_sizes_is_not_compared(blender: ModuleType, run) -> None:
    import json
    import shutil

    from roigs_addon.shared import run_files
    from roigs_addon.ui.result import ResultPanel

    folder = run[1]
    report = {"test_views": ["1"], "rois": [{"rows": [{"roi_psnr": 25}]}]}
    (folder / "report.json").write_text(json.dumps(report))
    (folder / "settings.json").write_text(json.dumps({"preset": "draft", "max_side": 640}))
    earlier = folder / "earlier" / "1"
    for file in (run_files.RESULT, run_files.BACKGROUND, "report.json", "settings.json"):
        (earlier / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(folder / file, earlier / file)

    def text() -> str:
        return " ".join(said(blender, ResultPanel))

    assert "25.0 dB at 640 px on 1 test photo" in text()
    assert "only at the same photo size" not in text()
    (earlier / "settings.json").write_text(json.dumps({"max_side": 320}))
    assert "25.0 dB at 320 px on 1 test photo" in text()
    assert "only at the same photo size" in text()


def test_the_label_of_test_photos_says_what_the_number_is(
    blender: ModuleType, run, monkeypatch: pytest.MonkeyPatch
) -> None:
    from types import SimpleNamespace

    from roigs_addon.ui import layout
    from roigs_addon.ui.train import TrainSettingsPanel

    settings, shown = run[0].roigs, []
    column = SimpleNamespace(prop=lambda _, name, text="": shown.append((name, text)))
    column.column = lambda **_: column
    monkeypatch.setattr(layout, "setting_column", lambda _: column)
    for none in (True, False):
        settings.no_tests, shown[:] = none, []
        said(blender, TrainSettingsPanel)
        assert settings.test_every == (0 if none else 8)
        assert (("test_every", "One Photo in") in shown) is not none


@pytest.mark.exact_look
def test_levels_of_detail(blender: ModuleType, run, monkeypatch: pytest.MonkeyPatch) -> None:
    from roigs_addon.ui.levels import LevelsPanel
    from roigs_addon.ui.result import ResultPanel
    from roigs_addon.viewport import draw
    from tests.addon.levels_cases import FAR, age, make_levels

    _, folder = run
    assert not LevelsPanel.poll(blender.context)
    blender.ops.roigs.load_results()
    assert LevelsPanel.poll(blender.context)
    told = said(blender, ResultPanel)
    assert "Result" in told and "First pass" in told and "Auto" not in told and "Full" not in told
    assert "Make levels to draw far objects faster" in " ".join(said(blender, LevelsPanel))
    make_levels(folder, rate=FAR)
    told = said(blender, ResultPanel)
    assert told.count("Auto") == 2 and {"Full", "Result", "First pass"} <= set(told)
    assert not any("Make levels" in text for text in said(blender, LevelsPanel))
    monkeypatch.setattr(draw, "counts", lambda area: (1234, 56789))
    assert "Drawn now: 1,234 of 56,789 Gaussians" in " ".join(said(blender, LevelsPanel))
    age(folder / "background.ply", 60)
    assert "older than the result" in " ".join(said(blender, LevelsPanel))


def test_finished_results_are_offered(blender: ModuleType, run) -> None:
    from roigs_addon.operators import stand_here
    from roigs_addon.ui.result import ResultPanel

    scene, folder = run
    wanted = "Load the results, or import some"
    assert wanted in " ".join(said(blender, ResultPanel))
    assert stand_here.problem(blender.context) == wanted
    scene.roigs.run_dir = str(folder.with_name("none"))
    assert "Train to get Gaussians" in " ".join(said(blender, ResultPanel))


def test_the_way_to_look_is_said_where_it_is_closed(blender: ModuleType, run) -> None:
    from roigs_addon.ui.clean_up import CleanUpPanel

    blender.ops.roigs.load_results()
    for name, told in (("thing", True), ("Background", False)):
        blender.context.view_layer.objects.active = run[0].objects[name]
        assert ("open Look" in " ".join(said(blender, CleanUpPanel))) == told


def test_what_runs_fits_into_the_bar(blender: ModuleType, addon: ModuleType) -> None:
    """The sidebar is narrow at first: the longest text that fits has about 30 letters."""
    from roigs_addon.engine import own_files
    from roigs_addon.jobs.state import JobState
    from roigs_addon.ui import layout

    for stage in own_files.STAGE_WORDS:
        bars: list[str] = []
        state = JobState(title="Making Surfaces", stage=stage, step=100, total=100)
        layout.progress(Layout(bars), state)
        assert len(bars[0]) <= 30, bars[0]
        assert bars[0][0].isupper()


def test_models_to_compare_with_have_one_name(addon: ModuleType) -> None:
    from roigs_addon.engine.own_files import stage_in_words

    stages = ("tuned-scene", "tuned-coarse-object-vase", "full-scene", "compare-joint-scene")
    assert {stage_in_words(stage) for stage in stages} == {"comparison"}
