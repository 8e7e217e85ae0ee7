"""Input is never run as code, and no file is written where it does not belong."""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from roigs_addon.engine import process
from roigs_addon.engine.command import Engine
from roigs_addon.engine.process import EngineProcess
from roigs_engine.cli import main
from roigs_engine.colmap.project import load_colmap
from roigs_engine.errors import RoiError
from roigs_engine.formats.names import safe_name
from roigs_engine.model.roi import roi_from_dict
from roigs_engine.model.scene import Camera, PosedImage
from roigs_engine.photos.decode import load_photo
from roigs_engine.photos.headers import PhotoError, photo_size
from tests import warm_engine
from tests.addon.colmap_project import write_project
from tests.addon.fake_engine import PYTHON, fake, finished

ROOT = Path(__file__).resolve().parent.parent
SHIPPED = ("roigs_engine", "roigs_addon")
# Begins again as the same program with the same arguments, in UTF-8.
RESTARTS = "roigs_engine/__main__.py"
# Reads the parts of an archive by name, and unpacks none to the disk.
READS_ZIP = "roigs_engine/exchange/sog.py"
# Opens pictures after checks of what they cost.
OPEN_PICTURES = ("roigs_engine/photos/", "roigs_engine/reconstruction/convert.py")
RUNS_CODE = re.compile(
    r"(pickle|cPickle|dill|marshal|shelve|joblib|yaml)\.\w*(load|Unpickler|open)\w*"
    r"|(builtins\.)?(eval|exec|compile|__import__|execfile)"
    r"|os\.(system|popen|exec\w*|spawn\w*|startfile)"
    r"|subprocess\.(getoutput|getstatusoutput)|commands\.\w+"
    r"|(zipfile|tarfile|shutil)\.(ZipFile|TarFile|open|unpack_archive)"
    r"|torch\.(jit|package|hub)\..*|tempfile\.mktemp"
    r"|trimesh\.load\w*"  # opens pictures of any format, of which PostScript is a program
)
SAYS = ("shell", "weights_only", "allow_pickle", "formats")


def calls() -> Iterator[tuple[str, str, dict[str, str]]]:
    """(place, dotted name, keyword of `SAYS` -> value) of every call in what is shipped."""
    for package in SHIPPED:
        for path in sorted((ROOT / package).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Call):
                    told = (k for k in node.keywords if k.arg in SAYS)
                    given = {str(k.arg): ast.unparse(k.value) for k in told}
                    place = f"{path.relative_to(ROOT)}:{node.lineno}"
                    yield place, dotted(node.func), given


def dotted(called: ast.expr) -> str:
    """The name of what is called, as it is written."""
    if isinstance(called, ast.Name):
        return called.id
    if isinstance(called, ast.Attribute):
        return f"{dotted(called.value)}.{called.attr}"
    return ast.unparse(called)


def test_nothing_is_run_or_unpickled() -> None:
    found = list(calls())
    assert len(found) > 3000
    for place, called, given in found:
        own = called == "os.execv" and place.startswith(f"{RESTARTS}:")
        own |= called == "zipfile.ZipFile" and place.startswith(f"{READS_ZIP}:")
        assert own or not RUNS_CODE.fullmatch(called), f"{place}: {called}"
        assert given.get("shell", "False") == "False", f"{place}: a shell"
        if called == "torch.load":
            assert given.get("weights_only") == "True", place
        if called in ("np.load", "numpy.load", "np.save", "numpy.save"):
            assert given.get("allow_pickle", "False") == "False", place
        if called.endswith(".getexif"):
            assert "photos/headers.py" in place, f"{place}: EXIF data are not checked: exif_of"
        if called == "Image.open":
            assert "formats" in given, f"{place}: PostScript would be run"
            assert place.startswith(OPEN_PICTURES), f"{place}: not open_picture"


def test_the_test_above_would_find_them() -> None:
    for name in ("pickle.load", "pickle.Unpickler", "eval", "os.system", "os.popen", "exec"):
        assert RUNS_CODE.fullmatch(name)


# Files opened plainly by these modules are their own, or the system's.
OWN_FILES = {
    *("formats/lock.py", "machine.py", "reconstruction/worker.py"),  # /proc, /sys, descriptors
    *("kernels/build.py", "cuda/compiler.py", "gpu/program.py", "exchange/page.py"),  # sources
    *("colmap/adjustment.py", "exchange/usd.py", "formats/scratch.py"),  # in a temporary folder
}


def test_no_pipe_is_waited_for() -> None:
    """A checked file may be a pipe by the time that it is opened."""
    plain = []
    for path in sorted((ROOT / "roigs_engine").rglob("*.py")):
        name = path.relative_to(ROOT / "roigs_engine").as_posix()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call) or name in OWN_FILES:
                continue
            called = dotted(node.func)
            if called == "open" and not any(key.arg == "opener" for key in node.keywords):
                plain.append(f"{name}:{node.lineno}: open")
            elif re.fullmatch(r"(?!made\.).+\.(read_bytes|read_text)", called):
                plain.append(f"{name}:{node.lineno}: {called}")
    assert not plain


# --- the engine's process ---


def test_the_engine_is_started_without_a_shell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[tuple[Any, dict[str, Any]]] = []
    popen = subprocess.Popen

    def noted(command: Sequence[str], **given: Any) -> Any:
        started.append((command, given))
        return popen(command, **given)

    monkeypatch.setattr(process.subprocess, "Popen", noted)
    engine = fake(
        tmp_path, "say(event='done', outputs={str(k): a for k, a in enumerate(sys.argv)})"
    )
    odd = ["train", "; touch x", "$(touch x)", "`touch x`", '"', "'", "*", "a b", "& touch x", "|"]
    monkeypatch.chdir(tmp_path)
    outcome, _ = finished(EngineProcess(engine, odd))
    ((command, given),) = started
    assert isinstance(command, list) and not given.get("shell") and "executable" not in given
    assert list(outcome.outputs.values())[1:] == [*odd, "--events"]
    assert not (tmp_path / "x").exists()


def test_secrets_of_the_environment_are_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    secret = "token-5d1f0a7c93"
    monkeypatch.setenv("FAKE_TOKEN", secret)
    scene, run = write_project(tmp_path / "scene"), tmp_path / "run"
    box = "thing=-0.5,-0.5,-0.5,0.5,0.5,0.5"
    monkeypatch.setattr(Engine, "command", warm_engine.quick(Engine.command))
    engine = Engine(python=PYTHON, source=ROOT)
    common = ["train", str(scene), "--roi", box, "--run-dir", str(run), "--max-side", "24"]
    for arguments in (
        [*common, "--steps-factor", "0.001"],
        [*common, "--steps-factor", "0.002"],  # refused: another request
    ):
        job = EngineProcess(engine, arguments, log=run / "blender" / "engine.log")
        assert job.wait(120)
        outcome = job.result()
        assert outcome.failed == (arguments[-1] != "0.001"), outcome.message
        assert secret not in outcome.message
    written = [path for path in run.rglob("*") if path.is_file()]
    assert {"result.ply", "events.jsonl", "engine.log"} <= {path.name for path in written}
    for path in written:
        assert secret.encode() not in path.read_bytes(), path


# --- names ---

OUTSIDE = (
    *("../../x", "..\\..\\x", "/tmp/x", "C:\\x", "C:x", "\\\\host\\share", "a/../../b"),
    *("..", "."),
)
NO_NAMES = (
    *("", " ", "a/b", "a\\b", "a:b", "a\0b", "a\nb", "x" * 300, "NUL", "con", "Com1.old", "a."),
    *(" a", "a ", "\ud800", "\udcff", "庭" * 90),
)


@pytest.mark.parametrize("name", [*OUTSIDE, *NO_NAMES])
def test_names_of_boxes_that_are_no_file_names(name: str) -> None:
    with pytest.raises(RoiError):
        roi_from_dict({"name": name, "min": [0, 0, 0], "max": [1, 1, 1]})


@pytest.mark.parametrize("name", ["vase", "Große Vase 2", "花瓶", "a.b", "-x", "console", "aux_1"])
def test_names_of_boxes_that_are(name: str) -> None:
    assert roi_from_dict({"name": name, "min": [0, 0, 0], "max": [1, 1, 1]}).name == name


def test_boxes_whose_files_would_be_the_same(tmp_path: Path, capsys: Any) -> None:
    """Windows and macOS make no difference between these."""
    boxes = [{"name": name, "min": [0, 0, 0], "max": [1, 1, 1]} for name in ("Vase", "vase")]
    (tmp_path / "rois.json").write_text(json.dumps(boxes))
    assert main(["inspect", str(tmp_path), "--rois", str(tmp_path / "rois.json")]) == 2
    assert "'vase'" in capsys.readouterr().err


@pytest.mark.parametrize("name", [*OUTSIDE, *NO_NAMES, "ok"])
def test_names_of_pictures_stay_in_their_folder(tmp_path: Path, name: str) -> None:
    path = tmp_path / f"{safe_name(name)}.png"
    assert path.resolve().parent == tmp_path
    path.touch()


@pytest.mark.parametrize("name", OUTSIDE[:-2])
def test_photos_outside_their_folder_are_not_looked_at(tmp_path: Path, name: str) -> None:
    scene = write_project(tmp_path / "a" / "scene", photos=3)
    photo = (scene / "images" / "photo 0.png").read_bytes()
    for place in (tmp_path / "a" / "x", tmp_path / "a" / "b", Path("/tmp/x")):
        if place.parent != Path("/tmp"):
            place.write_bytes(photo)
    images = scene / "sparse" / "0" / "images.txt"
    images.write_text(images.read_text().replace("photo 0.png", name))
    assert [image.name for image in load_colmap(scene).images] == ["photo 1.png", "photo 2.png"]


def test_links_are_replaced_and_not_written_through(tmp_path: Path) -> None:
    """A link in the run folder, prepared by somebody, does not lead a result elsewhere."""
    scene, out = write_project(tmp_path / "scene"), tmp_path / "out"
    kept = tmp_path / "kept.json"
    kept.write_text("mine")
    out.mkdir()
    (out / "thing.json").symlink_to(kept)
    box = "thing=-0.5,-0.5,-0.5,0.5,0.5,0.5"
    assert main(["select", str(scene), "--roi", box, "--out", str(out)]) == 0
    assert kept.read_text() == "mine" and not (out / "thing.json").is_symlink()


# --- photos ---


def test_a_photo_is_not_given_to_ghostscript(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pillow goes by the content: an EPS file called .jpg is a program for another program."""

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a program was started")

    monkeypatch.setattr(subprocess, "Popen", refuse)
    path = tmp_path / "a.jpg"
    Image.new("RGB", (64, 48)).save(path, "EPS")
    with pytest.raises(PhotoError):
        photo_size(path)
    camera = Camera(width=64, height=48, fx=1.0, fy=1.0, cx=0.0, cy=0.0)
    pose, rows = np.eye(4), np.empty(0, np.int64)
    with pytest.raises(PhotoError):
        load_photo(
            PosedImage(name="a", path=path, camera=camera, world_to_camera=pose, point_indices=rows)
        )


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
def test_pipes_and_devices_are_no_photos(tmp_path: Path) -> None:
    """They would be read for ever."""
    scene = write_project(tmp_path, photos=4)
    (scene / "images" / "photo 0.png").unlink()
    os.mkfifo(scene / "images" / "photo 0.png")
    (scene / "images" / "photo 1.png").unlink()
    (scene / "images" / "photo 1.png").symlink_to("/dev/zero")
    assert load_colmap(scene).skipped["missing on disk"] == ("photo 0.png", "photo 1.png")
