"""The table of a batch: what is wrong with it, and how `--init` writes it."""

from __future__ import annotations

import json
import shutil
import time
from pathlib import Path

import pytest

from roigs_engine.app.batch_plan import plan_row
from roigs_engine.app.batch_table import Table
from roigs_engine.batch.record import BatchRecord
from roigs_engine.cli import main
from roigs_engine.context import QUIET
from roigs_engine.formats.files import write_json, write_text
from tests.engine.clouds import cloud
from tests.engine.commands.command_line import BOX, refused
from tests.engine.synthetic_colmap import write_project

EIGHT = [f"{k}.png" for k in range(8)]


@pytest.fixture(scope="module")
def scans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scans")
    for name in ("hall", "attic"):
        write_project(folder / name, names=EIGHT)
    box = {"name": "vase", "min": [-0.5] * 3, "max": [0.5] * 3}
    (folder / "hall" / "rois.json").write_text(json.dumps({"rois": [box]}), encoding="utf-8")
    return folder


def test_init_writes_a_table_of_what_is_there(scans: Path, tmp_path: Path) -> None:
    table = scans / "museum.toml"
    assert main(["batch", str(table), "--init", str(scans)]) == 0
    rows = {row.name: row for row in Table(table, tmp_path).rows}
    assert set(rows) == {"hall", "attic"}
    assert rows["hall"].options["scene"] == str(scans / "hall")
    assert rows["hall"].options["rois"] == str(scans / "hall" / "rois.json")
    assert rows["attic"].options["roi"] == ["auto"]
    assert main(["batch", str(table), "--init", str(scans)]) == 2  # it is kept


def test_init_names_what_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for folder, says in ((tmp_path, "has no scene"), (tmp_path / "none", "There is no folder")):
        assert says in refused(capsys, "batch", tmp_path / "t.toml", "--init", folder)
    assert not (tmp_path / "t.toml").exists()


def test_every_wrong_line_is_named_and_nothing_starts(
    scans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "wrong.toml"
    lines = [
        "[defaults]",
        "presett = 'draft'",  # 2
        "outputs = ['docx']",
        "[scenes.one]",
        f"scene = '{scans / 'hall'}'",
        "max_side = -3",  # 6
        "from_up = 'x'",
        "[scenes.two]",  # 8, no scene
        "[scenes.three]",  # a box without points
        f"scene = '{scans / 'hall'}'",
        "roi = ['nothing=30,30,30,31,31,31']",
        "[scenes.four]",  # no such scene
        f"scene = '{scans / 'cellar'}'",
        f"roi = ['{BOX}']",
        '[scenes."result.ply"]',  # 15
        f"scene = '{scans / 'hall'}'",
        "[scenes.five]",  # 17, no box
        f"scene = '{scans / 'hall'}'",
        "[scenes.six]",  # 19, boxes without a model
        f"scene = '{shutil.copytree(scans / 'hall' / 'images', tmp_path / 'photos')}'",
        f"roi = ['{BOX}']",
    ]
    table.write_text("\n".join(lines), encoding="utf-8")
    run = tmp_path / "run"
    assert main(["batch", str(table), "--run-dir", str(run)]) == 2
    said = capsys.readouterr().err.splitlines()
    named = [line.partition("line ")[2].partition(":")[0] for line in said if "line " in line]
    assert named == ["2", "3", "6", "7", "8", "9", "12", "15", "17", "19"], said
    assert "Scene 'five' has no box. Add rois = " in "".join(said)
    assert '(roi = ["auto"] in a table)' in "".join(said)
    assert said[-1].startswith(f"error: {table} has 10 mistakes; nothing was started.")
    assert not list(run.glob("*"))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[scenes", "is not TOML"),
        (".".join(["a"] * 40_000) + " = 1", "a key has too many parts"),
        ('a = """\n[' + " " * 20_000 + '\n"""', "The table has no scene."),
        ("", "The table has no scene."),
        ("scenes = 3", "The table has no scene."),
        ("[scene.hall]", "no scene. 'scene' is unknown; write [defaults] or [scenes.NAME]."),
    ],
)
def test_a_table_that_is_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, says: str
) -> None:
    table = tmp_path / "t.toml"
    table.write_text(text, encoding="utf-8")
    assert says in refused(capsys, "batch", table, "--run-dir", tmp_path / "run")


def test_what_is_asked_for_wrongly(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = tmp_path / "t.toml"
    assert "needs TABLE and --run-dir" in refused(capsys, "batch", table)
    assert "Cannot read" in refused(capsys, "batch", table, "--run-dir", tmp_path / "run")
    line = refused(capsys, "batch", table, "--run-dir", tmp_path / "run", "--only", "hall")
    assert "--only chooses boxes" in line and "Use --scene NAME" in line


def test_results_are_not_written_to_memory(
    scans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "t.toml"
    table.write_text(f"[scenes.a]\nscene = '{scans / 'hall'}'\nroi = ['{BOX}']", encoding="utf-8")
    line = refused(capsys, "batch", table, "--run-dir", "memory://museum/runs")
    assert "are lost when the command ends" in line and "s3://BUCKET/RUNS" in line


def test_one_of_the_scenes(scans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = tmp_path / "t.toml"
    rows = [f"[scenes.{n}]\nscene = '{scans / n}'\nroi = ['{BOX}']" for n in ("hall", "attic")]
    table.write_text("\n".join(["[defaults]", "steps_factor = 0.003", *rows]), encoding="utf-8")
    options = ("batch", table, "--run-dir", tmp_path / "run", "--dry-run", "--scene")
    assert main([*map(str, options), "attic"]) == 0
    shown = capsys.readouterr().out
    assert "1 object in 1 scene," in shown and "\nattic " in shown and "hall" not in shown
    line = refused(capsys, *options, "attci")
    assert "There is no scene 'attci'. The scenes are: hall, attic." in line


def test_defaults_give_way_to_a_scenes_own_values(scans: Path, tmp_path: Path) -> None:
    table = tmp_path / "t.toml"
    lines = [
        *("[defaults]", "preset = 'draft'", f"roi = ['{BOX}']", "outputs = ['spz']"),
        *("[scenes.a]", f"scene = '{scans / 'hall'}'", "preset = 'paper'"),
        *("[scenes.b]", f"scene = '{scans / 'hall'}'", f"rois = '{scans / 'hall/rois.json'}'"),
    ]
    table.write_text("\n".join(lines), encoding="utf-8")
    a, b = Table(table, tmp_path).rows
    first, second = (row.request for row in (a, b))
    assert first.preset == "paper" and first.roi == (BOX,) and a.outputs == (".spz",)
    assert second.preset == "draft" and second.roi == () and b.options["compare"] == []
    assert a.digest != b.digest


def test_outputs_are_turned_as_convert_turns_them(scans: Path, tmp_path: Path) -> None:
    table = tmp_path / "t.toml"
    lines = [
        *("[defaults]", f"roi = ['{BOX}']", "outputs = ['glb']", "from-up = '-y'"),
        *("[scenes.a]", f"scene = '{scans / 'hall'}'", "from_up = 'z'", "sh_degree = 0"),
        *("[scenes.b]", f"scene = '{scans / 'hall'}'"),
    ]
    table.write_text("\n".join(lines), encoding="utf-8")
    found, record = {}, BatchRecord(tmp_path)
    for row in Table(table, tmp_path).rows:
        plan = plan_row(row, record, QUIET).scene
        found[row.name] = next(part.argv for part in plan.parts if part.argv[0] == "convert")
        assert not {"from_up", "sh_degree"} & row.options.keys()  # no options of `run`
    source, out = (str(tmp_path / name) for name in ("a/result.ply", "outputs/a.glb"))
    assert sorted(found["a"][:-2]) == ["--from-up=z", "--sh-degree=0", "convert"]
    assert found["a"][-2:] == (source, out)
    assert found["b"][1] == "--from-up=-y"
    (tmp_path / "outputs").mkdir()
    for argv in found.values():
        cloud().save_ply(Path(argv[-2]))
        assert main(list(argv)) == 0
    assert (tmp_path / "outputs/a.glb").stat().st_size < (tmp_path / "outputs/b.glb").stat().st_size


def test_two_scenes_do_not_write_one_file(scans: Path, tmp_path: Path) -> None:
    table = tmp_path / "t.toml"
    row = f"\nscene = '{scans / 'hall'}'\nroi = ['{BOX}']\n"
    lines = [
        f"[scenes.a]{row}outputs = ['glb', '.GLB', 'compressed.ply']",
        f"[scenes.'a.glb']{row}object_outputs = ['ply']",  # a folder of that name
        f"[scenes.'A.compressed']{row}outputs = ['ply']",
        f"[scenes.b]{row}outputs = ['ply', 'no such']",
    ]
    table.write_text("\n".join(lines), encoding="utf-8")
    found = Table(table, tmp_path)
    assert found.rows[0].outputs == (".glb", ".compressed.ply")
    assert [(wrong.line, wrong.text.partition(".")[0]) for wrong in found.wrong] == [
        (16, "'outputs' has 'no such', which is no format"),
        (5, "Scenes 'a' and 'a"),
        (9, "Scenes 'a' and 'A"),
    ]


def test_a_misspelt_head_is_named_with_its_line(
    scans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "t.toml"
    table.write_text("[scenes.hall]\nscene = 'hall'\n\n[scene.attic]\nscene = 'attic'\n")
    assert main(["batch", str(table), "--run-dir", str(tmp_path / "run")]) == 2
    assert "line 4: 'scene' is unknown" in capsys.readouterr().err


@pytest.mark.parametrize("key", ["outputs", "object_outputs"])
@pytest.mark.parametrize("ending", ["/../../out/x.spz", "\\..\\x.spz", "/x.ply", "b.ply", "x.SPZ"])
def test_formats_of_outputs_are_no_paths(
    scans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], key: str, ending: str
) -> None:
    """Files of the user's were written over."""
    table = tmp_path / "t.toml"
    row = f"[scenes.a]\nscene = '{scans / 'hall'}'\nroi = ['{BOX}']\n{key} = ['{ending}']\n"
    table.write_text(row, encoding="utf-8")
    assert main(["batch", str(table), "--run-dir", str(tmp_path / "run"), "--dry-run"]) == 2
    form = ending[-3:].lower()
    assert f"which is no format. Write {form}." in capsys.readouterr().err


@pytest.mark.parametrize(
    "name", ["batch.json", "batch.lock", "ROWS", "Outputs", ".leases", "Run.Lock"]
)
def test_a_scene_is_not_called_as_files_of_the_batch(
    scans: Path, tmp_path: Path, name: str
) -> None:
    table = tmp_path / "t.toml"
    row = f"[scenes.'{name}']\nscene = '{scans / 'hall'}'\nroi = ['{BOX}']\n"
    table.write_text(row, encoding="utf-8")
    assert [w.text for w in Table(table, tmp_path).wrong] == [
        f"A scene cannot be called '{name}', as its run folder is. Rename it."
    ]


def test_a_record_says_no_outputs_elsewhere(tmp_path: Path) -> None:
    write_text(tmp_path / "a.ply", "of the user's")
    write_text(tmp_path / "outputs" / "b.ply", "an output")
    places = ("../a.ply", str(tmp_path / "a.ply"), "x\0", "b.ply")
    outputs = {place: [[], [1, 2]] for place in places}
    write_json(tmp_path / "batch.json", {"version": 2, "scenes": {"hall": {"outputs": outputs}}})
    assert BatchRecord(tmp_path).left_over("hall", ()) == ["b.ply"]


def test_tens_of_thousands_of_mistakes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each was sought in all lines, and all were said."""
    table = tmp_path / "t.toml"
    keys = "".join(f"k{k} = 1\n" for k in range(20_000))
    table.write_text(f"[scenes.a]\nscene = 'a'\n{keys}", encoding="utf-8")
    began = time.process_time()
    assert main(["batch", str(table), "--run-dir", str(tmp_path / "run"), "--dry-run"]) == 2
    assert time.process_time() - began < 20
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 101
    assert "line 102: 'k99' is no key" in said
    assert "has 20,00" in said


def test_init_writes_toml_whatever_folders_are_called(tmp_path: Path) -> None:
    names = ["a\x7fb", 'c"d', "e\x1bf", "g\u0085h"]
    for name in names:
        write_project(tmp_path / "scans" / name, names=EIGHT[:2])
    table = tmp_path / "t.toml"
    assert main(["batch", str(table), "--init", str(tmp_path / "scans")]) == 0
    scenes = {row.options["scene"] for row in Table(table, tmp_path).rows}
    assert scenes == {str(tmp_path / "scans" / name) for name in names}


@pytest.mark.parametrize("name", ["report.html", "batch.json", "rows/hall.json", "outputs/a.glb"])
def test_files_of_others_are_not_replaced(
    scans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    table, theirs = tmp_path / "t.toml", tmp_path / "project" / name
    table.write_text(f"[scenes.hall]\nscene = '{scans / 'hall'}'\nroi = ['{BOX}']\n")
    theirs.parent.mkdir(parents=True)
    theirs.write_text("theirs")
    said = refused(capsys, "batch", table, "--run-dir", tmp_path / "project")
    assert "is not the folder of a batch" in said
    assert theirs.read_text() == "theirs"
