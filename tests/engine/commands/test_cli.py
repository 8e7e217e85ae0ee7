"""The command line as a person or a program meets it: help, errors, events, options files."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import roigs_engine
from roigs_engine.cli import COMMANDS, build_parser, main
from roigs_engine.formats.events import Message, Progress, to_json
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.selection import METHODS
from roigs_engine.training.checkpoint import checkpoint_fingerprint, load_checkpoint
from tests.engine.synthetic_colmap import Project, write_project

ROOT = Path(roigs_engine.__file__).resolve().parent.parent
BOX = "thing=-0.5,-0.5,-0.5,0.5,0.5,0.5"
EMPTY = "nothing=30,30,30,31,31,31"


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Project:
    names = [f"{k}.png" for k in range(8)]
    return write_project(tmp_path_factory.mktemp("cli") / "a scene", names=names)


@pytest.fixture(autouse=True)
def interrupt_handler() -> Iterator[None]:
    """Commands take Ctrl-C over; give it back."""
    before = signal.getsignal(signal.SIGINT)
    yield
    signal.signal(signal.SIGINT, before)


def start(*arguments: object) -> subprocess.Popen[str]:
    """The command line as a process of its own, its input open."""
    command = [sys.executable, "-m", "roigs_engine", *map(str, arguments)]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, cwd=ROOT, stdin=pipe, stdout=pipe, stderr=pipe, text=True)


def python(*arguments: object) -> subprocess.CompletedProcess[str]:
    """The command line as a process of its own, to its end; its input stays open until then."""
    with start(*arguments) as process:
        assert process.stdout is not None and process.stderr is not None
        out, err = process.stdout.read(), process.stderr.read()
        return subprocess.CompletedProcess(process.args, process.wait(120), out, err)


def write_one_gaussian(folder: Path) -> Path:
    path = folder / "one.ply"
    Gaussians.from_points(np.array([[0.0, 0, 3]]), np.zeros((1, 3), np.uint8)).save_ply(path)
    return path


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Run a command that must fail as people expect; returns its one line."""
    assert main([str(argument) for argument in arguments]) == 2
    out, err = capsys.readouterr()
    lines = err.strip().splitlines()
    assert out == ""
    assert len(lines) == 1, err
    assert lines[0].startswith("error: ")
    assert "Traceback" not in err
    return lines[0]


# --- help and version ---


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_every_command_has_help_with_examples(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as left:
        main([command, "--help"])
    assert left.value.code == 0
    out = capsys.readouterr().out
    assert "examples:" in out
    assert f"python -m roigs_engine {command} " in out
    assert "--events" in out


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_examples_in_the_help_are_accepted(command: str) -> None:
    text = COMMANDS[command].EXAMPLES.replace("\\\n", " ")
    examples = [line for line in text.splitlines() if line.strip()]
    assert examples
    for line in examples:
        words = shlex.split(line)
        assert words[:3] == ["python", "-m", "roigs_engine"]
        assert build_parser()[0].parse_args(words[3:]).command == command


def test_help_lists_the_commands_and_version_is_the_packages() -> None:
    shown = python("--help")
    assert shown.returncode == 0
    assert all(f"\n    {command}" in shown.stdout for command in COMMANDS)
    assert python("--version").stdout.strip() == roigs_engine.__version__


# --- errors: one line, status 2 ---


def test_no_roi(project: Project, capsys: pytest.CaptureFixture[str]) -> None:
    assert "--roi" in refused(capsys, "select", project.folder)


def test_unknown_roi_name(project: Project, capsys: pytest.CaptureFixture[str]) -> None:
    line = refused(capsys, "select", project.folder, "--roi", BOX, "--only", "vase")
    assert "'vase'" in line and "thing" in line


@pytest.mark.parametrize("text", ["thing", "thing=1,2,3", "=0,0,0,1,1,1", "a=0,0,0,1,1,x"])
def test_malformed_roi(project: Project, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    refused(capsys, "select", project.folder, "--roi", text)


def test_roi_without_volume(project: Project, capsys: pytest.CaptureFixture[str]) -> None:
    assert "'flat'" in refused(capsys, "select", project.folder, "--roi", "flat=0,0,0,1,1,0")


def test_two_rois_of_one_name(project: Project, capsys: pytest.CaptureFixture[str]) -> None:
    line = refused(capsys, "inspect", project.folder, "--roi", BOX, "--roi", BOX)
    assert "'thing'" in line


def test_box_without_points_names_box_and_nearest_points(project: Project) -> None:
    result = python("select", project.folder, "--roi", EMPTY)
    assert result.returncode == 2
    assert result.stdout == ""
    (line,) = result.stderr.strip().splitlines()
    assert line.startswith("error: ")
    assert "'nothing'" in line and "Nearest points" in line
    assert "1 x 1 x 1" in line


def test_no_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert str(tmp_path) in refused(capsys, "inspect", tmp_path)
    assert "nowhere" in refused(capsys, "inspect", tmp_path / "nowhere")


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin", "points3D.bin"])
@pytest.mark.parametrize("damage", ["cut", "noise"])
def test_unreadable_model(
    tmp_path: Path, name: str, damage: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_project(tmp_path).folder / "sparse" / "0" / name
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2] if damage == "cut" else b"\xff" * len(data))
    assert name in refused(capsys, "select", tmp_path, "--roi", BOX)


def test_no_photos(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_project(tmp_path, images=None)
    assert "--images" in refused(capsys, "select", tmp_path, "--roi", BOX)


def test_no_points(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import numpy as np

    write_project(tmp_path, points=np.zeros((0, 3)))
    assert "points" in refused(capsys, "select", tmp_path, "--roi", BOX)


@pytest.mark.parametrize(
    "options",
    [
        ["--count", "0"],
        ["--seed", "-1"],
        ["--downscale", "0"],
        ["--max-side", "0"],
        ["--test-every", "1"],
        ["--rois", "missing.json"],
    ],
)
def test_values_out_of_range(
    project: Project, options: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    refused(capsys, "select", project.folder, "--roi", BOX, *options)


@pytest.mark.parametrize(
    "options",
    [["--steps-factor", "0"], ["--kept-share", "2"], ["--test-every", "1"], ["--count", "-3"]],
)
def test_training_values_out_of_range(
    project: Project, tmp_path: Path, options: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    refused(capsys, "train", project.folder, "--roi", BOX, "--run-dir", folder, *options)
    assert not folder.exists(), "a refused command leaves nothing behind"


def test_files_that_are_no_splats(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ply = tmp_path / "a.ply"
    ply.write_bytes(b"ply\nnothing\n")
    out = tmp_path / "out.ply"
    line = refused(capsys, "compose", ply, "--roi", BOX, "--object", f"thing={ply}", "--out", out)
    assert "a.ply" in line
    assert not out.exists()
    cameras = tmp_path / "cameras.json"
    model = f"thing={write_one_gaussian(tmp_path)}"
    command = ["compose", tmp_path / "one.ply", "--roi", BOX, "--object", model]
    assert "twice" in refused(capsys, *command, "--object", model, "--out", out)
    record = {"name": "a", "width": 8, "height": 8, "fx": 9.0, "fy": 9.0, "cx": 4.0, "cy": 4.0}
    record["world_to_camera"] = np.eye(4).tolist()
    cameras.write_text(json.dumps({"cameras": [record]}), encoding="utf-8")
    command = ["render", tmp_path / "one.ply", "--path", cameras, "--out", tmp_path]
    command += ["--device", "cpu"]  # else it says why not on a card
    assert "'b'" in refused(capsys, *command, "--name", "b")
    line = refused(capsys, "render", tmp_path / "no.ply", "--path", cameras, "--out", tmp_path)
    assert "no.ply" in line


@pytest.mark.parametrize(
    ("given", "named"),
    [
        (("select", "scene", "--out", "out", "--colour", "blue"), "--colour"),
        (("inspect", "scene", "--max-side", "large"), "--max-side"),
        (("train", "scene"), "--run-dir"),
        (("paint", "scene"), "paint"),
    ],
)
def test_options_that_do_not_fit(
    given: tuple[str, ...], named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refused(capsys, *given)
    assert named in line and "--help" in line


def test_options_that_do_not_fit_are_an_event(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "scene", "--run-dir", "run", "--preset", "best", "--events"]) == 2
    event = json.loads(capsys.readouterr().out)
    assert event["event"] == "failed" and "best" in event["message"]


# --- what works ---


def test_select_end_to_end(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--roi", BOX, "--method", "greedy", "--count", "3", "--out", str(tmp_path)]
    assert main(["select", str(project.folder), *arguments]) == 0
    shown = capsys.readouterr().out
    stored = json.loads((tmp_path / "thing.json").read_text(encoding="utf-8"))
    assert (stored["roi"], stored["method"], len(stored["names"])) == ("thing", "greedy", 3)
    assert set(stored["names"]) <= set(project.names)
    assert all(name in shown for name in stored["names"])


WITHOUT = """
import sys
from importlib.abc import MetaPathFinder

class Missing(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in missing:
            raise ModuleNotFoundError("it is not here", name=name)

missing, folder, box, out, *methods = sys.argv[1:]
missing = set(missing.split(","))
sys.meta_path.insert(0, Missing())
from roigs_engine.cli import main
for method in methods:
    assert main(["select", folder, "--roi", box, "--method", method, "--test-every", "4"]) == 0
assert main(["inspect", folder, "--roi", box]) == 0
assert main(["export", folder, "--out", out]) == 0
assert not missing & {name.partition(".")[0] for name in sys.modules}
assert main(["train", folder, "--roi", box, "--run-dir", out]) == 2
"""
ALL_BUT_NUMPY = "torch,sklearn,scipy,PIL,pycolmap,tqdm"


def without(missing: str, project: Project, out: Path, *methods: str) -> str:
    """Standard output of selecting, inspecting and exporting in a Python without these."""
    command = [sys.executable, "-c", WITHOUT, missing, str(project.folder), BOX, str(out), *methods]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert "error: `train` needs torch" in result.stderr
    return result.stdout


def test_inspect_and_every_selection_need_no_torch(project: Project, tmp_path: Path) -> None:
    shown = without("torch", project, tmp_path / "out", *METHODS)
    assert all(f"selected by {method}" in shown for method in METHODS)


def test_what_blender_runs_itself_needs_numpy_alone(project: Project, tmp_path: Path) -> None:
    methods = [method for method in METHODS if not method.startswith("gp")]
    lean = without(ALL_BUT_NUMPY, project, tmp_path / "a", *methods)
    assert without("torch", project, tmp_path / "b", *methods).replace("/b", "/a") == lean
    for name in ("scene.json", "points.npy", "observed.npy"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_test_photos_are_not_selected(project: Project, tmp_path: Path) -> None:
    arguments = ["--roi", BOX, "--test-every", "4", "--count", "8", "--out", str(tmp_path)]
    assert main(["select", str(project.folder), *arguments]) == 0
    stored = json.loads((tmp_path / "thing.json").read_text(encoding="utf-8"))
    assert len(stored["candidates"]) == 6


def test_inspect_in_json(project: Project, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", str(project.folder), "--roi", BOX, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["photos"] == len(project.names)
    assert report["points"] == len(project.points)
    assert report["rois"][0]["name"] == "thing"


# --- events ---


def events(result: subprocess.CompletedProcess[str]) -> list[dict[str, Any]]:
    """Standard output with --events: JSON lines and nothing else."""
    return [json.loads(line) for line in result.stdout.splitlines()]


def test_every_event_is_one_line_of_strict_json() -> None:
    nan = float("nan")
    progress = Progress(
        stage="a", step=1, total=2, loss=nan, psnr=-nan, gaussians=3, seconds_left=float("inf")
    )
    record = json.loads(to_json(progress), parse_constant=pytest.fail)
    assert record["event"] == "progress"
    assert record["step"] == 1
    assert record["loss"] is record["psnr"] is record["seconds_left"] is None
    line = to_json(Message(text="two\nlines, '模型'"))
    assert "\n" not in line and "模型" in line


def test_events_end_in_done(project: Project) -> None:
    result = python("select", project.folder, "--roi", BOX, "--events")
    assert result.returncode == 0
    assert events(result)[-1] == {"event": "done", "outputs": {}, "stopped": False}


def test_a_failure_is_an_event(project: Project) -> None:
    result = python("select", project.folder, "--roi", EMPTY, "--events")
    assert result.returncode == 2
    last = events(result)[-1]
    assert last["event"] == "failed"
    assert "'nothing'" in last["message"]
    assert last["hint"]
    assert "Traceback" not in result.stderr


def train(project: Project, folder: Path, *options: object) -> subprocess.Popen[str]:
    """A training run in its first stage, with a preview every moment."""
    process = start(
        *("train", project.folder, "--roi", BOX, "--run-dir", folder, "--test-every", 3),
        *("--events", "--threads", 1, "--preview-seconds", 0.01, *options),
    )
    assert process.stdout is not None
    for line in process.stdout:
        if json.loads(line)["event"] == "preview":
            return process
    raise AssertionError(process.communicate()[1])


def checkpoint_step(folder: Path) -> int:
    path = folder / "scene" / "checkpoint.bin"
    return int(load_checkpoint(path, checkpoint_fingerprint(path))["step"])


@pytest.mark.parametrize("text", ["stop\n", ""])
def test_a_stop_or_the_end_of_input_stops_training(
    project: Project, tmp_path: Path, text: str
) -> None:
    folder = tmp_path / "run"
    process = train(project, folder)
    out, err = process.communicate(text, timeout=60)
    assert process.returncode == 3, err
    lines = [json.loads(line) for line in out.splitlines()]
    assert lines[-1] == {"event": "done", "outputs": {}, "stopped": True}
    assert (folder / "preview.ply").stat().st_size > 0
    assert checkpoint_step(folder) > 0
    log = (folder / "events.jsonl").read_text(encoding="utf-8").splitlines()
    assert json.loads(log[-1])["event"] == "done"
    assert not (folder / "run.lock").exists()


def test_a_run_outlives_nobody_and_leaves_a_checkpoint(project: Project, tmp_path: Path) -> None:
    """Both pipes break at once, as when the parent was killed."""
    folder = tmp_path / "run"
    process = train(project, folder)
    for pipe in (process.stdin, process.stdout, process.stderr):
        assert pipe is not None
        pipe.close()
    assert process.wait(60) == 3
    assert checkpoint_step(folder) > 0


def test_a_second_engine_is_refused(project: Project, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    process = train(project, folder)
    lock = json.loads((folder / "run.lock").read_text(encoding="utf-8"))
    assert lock["pid"] == process.pid
    second = python("train", project.folder, "--roi", BOX, "--run-dir", folder, "--test-every", 3)
    assert second.returncode == 2
    assert f"process {process.pid}" in second.stderr
    assert len(second.stderr.strip().splitlines()) == 1
    process.kill()
    process.communicate()
    assert (folder / "run.lock").exists()
    # What a dead process has left does not hold up the next one.
    train(project, folder).communicate("stop\n", timeout=60)
    assert not (folder / "run.lock").exists()


def test_a_stop_while_loading_is_answered(project: Project, tmp_path: Path) -> None:
    process = start("export", project.folder, "--out", tmp_path / "out", "--events")
    out, _ = process.communicate("stop\n", timeout=60)
    assert process.returncode in (0, 3)  # 0: it was done before the line was read
    assert json.loads(out.splitlines()[-1])["stopped"] == (process.returncode == 3)


def test_no_test_photos(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [project.folder, "--roi", BOX, "--run-dir", tmp_path / "run", "--test-every", 0]
    assert "`train`" in refused(capsys, "run", *arguments)
    assert not (tmp_path / "run").exists()


def test_a_selection_folder_without_the_boxes_is_refused(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [project.folder, "--roi", BOX, "--run-dir", tmp_path / "run"]
    assert "thing.json" in refused(capsys, "train", *arguments, "--selection", tmp_path)
    (tmp_path / "thing.json").write_text("{}", encoding="utf-8")
    assert "'names'" in refused(capsys, "train", *arguments, "--selection", tmp_path)
    assert not (tmp_path / "run").exists()


@pytest.mark.skipif(sys.platform != "linux", reason="names are text there")
@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
def test_names_that_cannot_be_printed(
    project: Project, tmp_path: Path, encoding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A photo on disk whose name is no UTF-8, and an output that has few letters."""
    shutil.copytree(project.folder, tmp_path / "scene")
    photos = os.fsencode(tmp_path / "scene" / "images")
    shutil.copy(os.path.join(photos, b"0.png"), os.path.join(photos, b"caf\xe9.png"))
    monkeypatch.setenv("PYTHONIOENCODING", encoding)
    for options in ([], ["--json"], ["--events"]):
        result = python("inspect", tmp_path / "scene", *options)
        assert result.returncode == 0 and "Traceback" not in result.stderr
        assert "caf\\udce9.png" in result.stdout + result.stderr


# --- options files ---


def options_file(folder: Path, **values: object) -> Path:
    path = folder / "options.json"
    path.write_text(json.dumps(values), encoding="utf-8")
    return path


def test_a_options_file_stands_for_options(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = options_file(
        tmp_path, scene=str(project.folder), roi=[BOX], method="fvs", count=2, out=str(tmp_path)
    )
    assert main(["select", str(file)]) == 0
    stored = json.loads((tmp_path / "thing.json").read_text(encoding="utf-8"))
    assert (stored["method"], len(stored["names"])) == ("fvs", 2)
    # What is null is as if it were not there, and a number may be written as 640.0.
    values = {"max_side": 640.0, "count": 2, "seed": None, "only": None, "method": None}
    same = options_file(tmp_path, scene=str(project.folder), roi=BOX, **values)
    assert main(["select", str(same)]) == 0
    options_file(
        tmp_path, scene=str(project.folder), roi=[BOX], method="fvs", count=2, out=str(tmp_path)
    )
    # An option beside the file wins.
    assert main(["select", str(file), "--count", "4"]) == 0
    stored = json.loads((tmp_path / "thing.json").read_text(encoding="utf-8"))
    assert (stored["method"], len(stored["names"])) == ("fvs", 4)
    capsys.readouterr()


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"colour": "blue"}, "'colour'"),
        ({"help": True}, "'help'"),
        ({"method": "best"}, "'method'"),
        ({"count": "many"}, "'count'"),
        ({"count": "3"}, "'count'"),
        ({"count": 2.5}, "'count'"),
        ({"count": True}, "'count'"),
        ({"count": float("inf")}, "'count'"),
        ({"count": [1, 2]}, "'count'"),
        ({"max-side": 10**400}, "max_side"),
        ({"downscale": 10**400}, "'downscale'"),
        ({"only": [5]}, "'only'"),
        ({"only": {"a": 1}}, "'only'"),
        ({"method": ["static"]}, "'method'"),
        ({"events": 1}, "'events'"),
        ({"images": "a\0b"}, "'images'"),
        ({"images": "x" * 5000}, "xxx"),
        ({"rois": 5}, "'rois'"),
        ({"threads": float("nan")}, "'threads'"),
        ({"seed": 1 << 40, "method": "random"}, "seed"),
        ({"events": True}, "'events'"),
        ({"max_side": 40, "downscale": 2.0}, "'downscale'"),
    ],
)
def test_an_options_file_with_a_wrong_key_or_value_is_refused(
    project: Project,
    tmp_path: Path,
    values: dict[str, object],
    named: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = options_file(tmp_path, scene=str(project.folder), roi=[BOX], **values)
    assert named in refused(capsys, "select", file)


def test_an_option_beside_the_file_wins_over_what_excludes_it(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = options_file(tmp_path, scene=str(project.folder), max_side=20)

    def width(*options: object) -> int:
        assert main(["export", str(file), "--out", str(tmp_path), *map(str, options)]) == 0
        return int(json.loads((tmp_path / "scene.json").read_text("utf-8"))["largest"][0])

    assert width() == 20
    assert width("--downscale", 1) == 2 * width("--downscale", 2) > 40


def test_an_options_file_that_is_none_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "scene" in refused(capsys, "select", options_file(tmp_path, roi=[BOX]))
    broken = tmp_path / "broken.json"
    broken.write_text("{", encoding="utf-8")
    assert "broken.json" in refused(capsys, "select", broken)
    assert "gone.json" in refused(capsys, "select", tmp_path / "gone.json")
    assert "xxx" in refused(capsys, "select", options_file(tmp_path, scene="x" * 5000, roi=[BOX]))


def test_what_does_not_fit_into_memory_is_one_line(
    project: Project, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for error in (MemoryError(), RuntimeError("DefaultCPUAllocator: can't allocate memory")):

        def fail(*_: object, error: Exception = error) -> None:
            raise error

        monkeypatch.setattr(COMMANDS["inspect"], "run", fail)
        assert "memory" in refused(capsys, "inspect", project.folder)


@pytest.mark.parametrize("page", ["README.md", "docs/commands.md", "docs/files.md"])
def test_commands_in_the_documents_are_accepted(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8").replace("\\\n", " ")
    start = "python -m roigs_engine "
    lines = [line.partition(start)[2] for line in text.splitlines() if start in line]
    lines += re.findall(rf"^\| `((?:{'|'.join(COMMANDS)}) .*?)` \|", text, re.MULTILINE)
    commands = [line for line in lines if line.split() and line.split()[0] in COMMANDS]
    assert commands
    for line in commands:
        words = shlex.split(line.rstrip("`").replace("\\", "/"))
        assert build_parser()[0].parse_args(words).command == words[0]
