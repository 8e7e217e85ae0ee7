"""The environment for the engine: which Python, which steps, incomplete ones."""

from __future__ import annotations

import functools
import os
import re
import sys
import time
from pathlib import Path

import pytest

from roigs_addon.engine import base_python, check, environments, install, install_steps, python
from roigs_addon.engine.graphics_card import BUILDS
from roigs_addon.engine.install import Installation
from roigs_addon.engine.install_steps import Plan, Step
from roigs_addon.errors import AddonError
from tests.addon.scenes import ROOT
from tools.lock_packages import entries


@pytest.fixture(autouse=True)
def _nothing_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(python.VARIABLE, raising=False)
    python.ability.cache_clear()


def run(installation: Installation) -> Installation:
    installation.start()
    deadline = time.monotonic() + 30
    while not installation.finished and time.monotonic() < deadline:
        time.sleep(0.02)
    assert installation.finished
    return installation


def fake_steps(monkeypatch: pytest.MonkeyPatch, *codes: str) -> None:
    """Replace venv and pip by other programs; the first makes the folder."""

    def steps(plan: Plan, base: Path, environment: Path) -> list[Step]:
        made = f"import os; os.makedirs({str(environment)!r})"
        return [
            Step(title=f"Step {number}", command=[sys.executable, "-uc", code])
            for number, code in enumerate([made, *codes])
        ]

    monkeypatch.setattr(install, "steps", steps)
    monkeypatch.setattr(install, "choose_python", lambda wheels: Path(sys.executable))


def test_requirements_are_those_of_the_project() -> None:
    wanted = install_steps.requirements()
    assert any(r.startswith("torch==") for r in wanted)
    assert any(r.startswith("numpy") for r in wanted)


def locked() -> dict[str, list[str]]:
    """Name of a file -> its packages, as pip reads them."""
    folder = ROOT / "tools" / "locked"
    return {path.stem: entries(path.read_text("utf-8")) for path in folder.glob("*.txt")}


def test_what_is_downloaded_has_hashes() -> None:
    """And nothing else is in these files: no other index, no option of pip."""
    assert locked().keys() == {
        *(install_steps.PIP, install_steps.ENGINE),
        *map(install_steps.name_of, install_steps.optional_packages(formats=True)),
    }
    form = r"[a-z0-9-]+==[0-9.]+( ; [^\n\\]+)? \\\n(    --hash=sha256:[0-9a-f]{64}( \\)?\n)+"
    for name, packages in locked().items():
        assert packages
        for package in packages:
            assert re.fullmatch(form, package), (name, package[:80])
        text = (ROOT / "tools" / "locked" / f"{name}.txt").read_text("utf-8")
        assert text == "".join(packages)


def test_what_is_downloaded_is_what_the_project_asks_for() -> None:
    """`tools/lock_packages.py` makes the files anew when the requirements change."""
    version = pytest.importorskip("packaging.requirements")
    files = locked()
    wanted = [(install_steps.ENGINE, asked) for asked in install_steps.requirements()]
    wanted += [
        (install_steps.name_of(asked), asked)
        for asked in install_steps.optional_packages(formats=True)
    ]
    for name, asked in wanted:
        requirement = version.Requirement(asked)
        if requirement.name == "torch":
            continue
        there = [
            found
            for text in files[name]
            if (found := version.Requirement(text.partition(" \\")[0])).name == requirement.name
        ]
        assert there, asked
        for found in there:
            (exact,) = found.specifier
            assert requirement.specifier.contains(exact.version), (asked, str(found))


def test_each_download_of_the_set_up_is_checked(tmp_path: Path) -> None:
    """But for torch's: each of its indexes has builds of its own."""
    steps = install_steps.steps(Plan(environments=(tmp_path,)), Path("python"), tmp_path / "1")
    downloads = [step.command for step in steps if "install" in step.command]
    assert len(downloads) > 8
    for command in downloads:
        assert {"--require-hashes", "--no-deps", "--only-binary"} <= set(command)
        assert Path(command[-1]).is_file()


@pytest.mark.parametrize("wheels", [False, True])
@pytest.mark.parametrize("formats", [False, True])
def test_what_not_every_platform_has_is_installed_where_it_can_be(
    tmp_path: Path, *, wheels: bool, formats: bool
) -> None:
    """Where there are no wheels, the set-up must not compile, nor fail."""
    plan = Plan(environments=(tmp_path,), formats=formats, wheels=tmp_path if wheels else None)
    steps = install_steps.steps(plan, Path("python"), tmp_path / "1")
    optional = [step.command for step in steps if not step.needed]
    names = [Path(command[-1]).stem if not wheels else command[-1] for command in optional]
    names = [install_steps.name_of(name) for name in names]
    assert names[:3] == ["av", "pillow-heif", "opencv-python-headless"]
    assert ({"gsply", "usd-core", "pygltflib"} <= set(names[3:])) == formats
    assert all(":all:" in command for command in optional)
    assert all(("--no-index" in command) == wheels for command in optional)
    assert not any("av>" in name for name in install_steps.requirements())  # of the marker
    assert steps[-1].needed


def test_what_is_not_needed_may_fail(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake_steps(monkeypatch)
    planned = install.steps
    fails = Step(
        title="More", command=[sys.executable, "-c", "raise SystemExit('no wheel')"], needed=False
    )
    monkeypatch.setattr(install, "steps", lambda *given: [*planned(*given), fails])
    done = run(Installation(Plan(environments=(tmp_path,))))
    assert done.message == "" and done.python is not None
    said = done.log.read_text(encoding="utf-8")
    assert "no wheel" in said and "works without it" in said


def test_success_leaves_one_complete_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake_steps(monkeypatch, "print('Progress 5 of 10'); print('fine')")
    for _ in range(2):
        done = run(Installation(Plan(environments=(tmp_path,))))
        assert done.message == "" and done.fraction == 1.0
    (environment,) = python.complete_environments([tmp_path])
    assert environment == tmp_path / "2"
    assert done.python == python.environment_python(environment)
    assert "fine" in done.log.read_text(encoding="utf-8")
    assert [path.name for path in tmp_path.iterdir() if path.is_dir()] == ["2"]


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if path.is_dir())


def test_an_environment_in_use_stays_until_a_later_installation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake_steps(monkeypatch)
    first = run(Installation(Plan(environments=(tmp_path,)))).python
    assert first is not None
    with environments.using(first):
        for made in (["1", "2"], ["1", "3"]):
            run(Installation(Plan(environments=(tmp_path,))))
            assert names(tmp_path) == made
    run(Installation(Plan(environments=(tmp_path,))))
    assert names(tmp_path) == ["4"]


def test_an_environment_of_an_earlier_version_is_used_until_one_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake_steps(monkeypatch)
    shared, earlier = tmp_path / "shared", tmp_path / "extension"
    old = run(Installation(Plan(environments=(earlier,)))).python
    assert python.candidates("", (shared, earlier))[0] == old
    new = run(Installation(Plan(environments=(shared, earlier)))).python
    assert python.candidates("", (shared, earlier))[0] == new and new.is_relative_to(shared)
    assert names(earlier) == []


def test_one_installation_at_a_time_in_a_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake_steps(monkeypatch)
    folder = tmp_path / "engine"
    with environments.alone(folder):
        refused = run(Installation(Plan(environments=(folder,))))
    assert (
        refused.message
        == f"Process {os.getpid()} is setting up the engine. Wait until it has finished."
    )
    assert names(tmp_path) == []  # nor the folder, which was empty


def test_downloads_are_kept_for_another_try_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    download = "import os, pathlib; p = pathlib.Path(os.environ['PIP_CACHE_DIR']); p.mkdir()"
    downloads = tmp_path / environments.DOWNLOADS
    fake_steps(monkeypatch, download, "raise SystemExit(1)")
    run(Installation(Plan(environments=(tmp_path,))))
    assert downloads.is_dir()
    fake_steps(monkeypatch)
    run(Installation(Plan(environments=(tmp_path,))))
    assert not downloads.exists()


def test_failure_says_pips_last_error_and_keeps_what_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake_steps(monkeypatch)
    run(Installation(Plan(environments=(tmp_path,))))
    fake_steps(monkeypatch, "print('ERROR: No space left'); print('notice'); raise SystemExit(1)")
    failed = run(Installation(Plan(environments=(tmp_path,))))
    assert failed.message == f"Step 1 failed: No space left. See the log {tmp_path / 'setup.log'}"
    assert [path.name for path in python.complete_environments([tmp_path])] == ["1"]
    assert (tmp_path / "2").is_dir()  # incomplete, and removed by the next installation
    fake_steps(monkeypatch)
    run(Installation(Plan(environments=(tmp_path,))))
    assert [path.name for path in tmp_path.iterdir() if path.is_dir()] == ["3"]


@pytest.mark.skipif(os.name == "nt", reason="looks for the process the POSIX way")
def test_stop_ends_what_the_step_started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    child = "import time; print('child', flush=True); time.sleep(60)"
    code = (
        "import subprocess, sys; p = subprocess.Popen([sys.executable, '-c',"
        f" {child!r}]); print('pid', p.pid, flush=True); p.wait()"
    )
    fake_steps(monkeypatch, code)
    installation = Installation(Plan(environments=(tmp_path,)))
    installation.start()
    deadline = time.monotonic() + 30
    said = ""
    while "\nchild\n" not in said and time.monotonic() < deadline:
        time.sleep(0.02)
        said = installation.log.read_text(encoding="utf-8") if installation.log.exists() else ""
    pid = int(next(line for line in said.splitlines() if line.startswith("pid "))[4:])
    installation.stop()
    assert installation.finished and installation.message == "Setting up was stopped."
    assert not python.complete_environments([tmp_path])
    deadline = time.monotonic() + 5
    while _lives(pid) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not _lives(pid)


def _lives(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0]
    except OSError:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return False
        return not Path("/proc").is_dir()
    return state != "Z"


def test_wheels_decide_the_version(tmp_path: Path) -> None:
    with pytest.raises(AddonError, match="no wheel of torch"):
        base_python.choose_python(tmp_path)
    (tmp_path / "torch-2.13.0+cpu-cp399-cp399-linux_x86_64.whl").touch()
    assert base_python.wheel_versions(tmp_path) == {(3, 99)}
    with pytest.raises(AddonError, match=r"Install Python 3\.99"):
        base_python.choose_python(tmp_path)


def test_a_program_that_is_no_python_is_passed_over() -> None:
    assert base_python._version(["/nowhere/python3.11"]) == (0, 0)
    assert base_python._version([sys.executable]) in ((0, 0), sys.version_info[:2])


def test_offline_steps_ask_no_index(tmp_path: Path) -> None:
    base, made = Path("python"), tmp_path / "1"
    plan = Plan(environments=(tmp_path,), formats=False, wheels=tmp_path)
    offline = install_steps.steps(plan, base, made)
    assert [step.title for step in offline] == [
        "Creating the environment",
        "Installing",
        "Installing av",
        "Installing pillow-heif",
        "Installing opencv-python-headless",
        "Installing fast-simplification",
        "Installing scikit-image",
        "Installing trimesh",
        "Installing wgpu",
        "Removing unneeded files",
        "Testing the environment",
    ]
    assert all("--no-index" in step.command for step in offline[1:-2])
    assert [step.needed for step in offline] == [True] * 2 + [False] * 7 + [True] * 2
    online = install_steps.steps(
        Plan(environments=(tmp_path,), torch_index=BUILDS[0].index), base, made
    )
    scripts = [part for step in online for part in step.command if part.endswith(".py")]
    own = ("install_torch", "trim_engine", "try_engine")
    assert scripts == [str(ROOT / "tools" / f"{name}.py") for name in own]
    index = BUILDS[0].index
    assert sys.platform == "darwin" or any(index in step.command for step in online)
    asked = [part for step in online for part in step.command]
    assert not any(part.startswith("gsplat") for part in asked)  # it would need a compiler


def test_check_says_what_works_and_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = python.Ability(version=(3, 12), missing=("torch", "pycolmap"))
    monkeypatch.setattr(python, "ability", functools.lru_cache(lambda path: found))
    said = {f.text: f.works for f in check.check("/opt/python", [tmp_path])}
    assert said["Reading models: ready"]
    assert said["Selecting by Gaussian process: ready"]
    assert not said["Training and rendering: not ready: Python 3.12 lacks torch"]
    assert said["Python 3.12: /opt/python"]
    check.forget()


def test_check_of_a_python_that_does_not_exist(tmp_path: Path) -> None:
    findings = check.check(str(tmp_path / "python"), [tmp_path])
    assert not any(finding.works for finding in findings)
    assert "does not start" in findings[-1].text
    check.forget()


@pytest.mark.skipif(os.name == "nt", reason="no such program")
def test_check_of_a_program_that_is_no_python(tmp_path: Path) -> None:
    findings = check.check("/bin/ls", [tmp_path])
    assert findings[-1].text.endswith("it is not a working Python")
    check.forget()


def test_check_says_that_an_environment_is_of_other_packages(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = python.Ability(version=(3, 12), missing=())
    monkeypatch.setattr(python, "ability", functools.lru_cache(lambda path: found))
    fake_steps(monkeypatch)
    made = run(Installation(Plan(environments=(tmp_path,)))).python
    same = check.check("", [tmp_path])[-1]
    assert same.works and same.text == f"Python 3.12: {made}"
    (tmp_path / "1" / python.MARKER).write_text('{"requirements": ["torch==1.0"]}')
    other = check.check("", [tmp_path])[-1]
    assert not other.works and other.text.endswith("set up the engine again")
    check.forget()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
def test_what_is_in_the_place_of_the_log_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake_steps(monkeypatch, "print('fine')")
    log, mine = tmp_path / environments.SETUP_LOG, tmp_path / "mine"
    mine.write_text("mine")
    log.symlink_to(mine)
    for _ in range(2):
        assert run(Installation(Plan(environments=(tmp_path,)))).message == ""
        assert mine.read_text() == "mine" and "fine" in log.read_text(encoding="utf-8")
        log.unlink()
        os.mkfifo(log)


def test_a_full_disk_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """ensurepip, say, ends with its command line alone."""
    fake_steps(monkeypatch, "raise SystemExit('it returned 1')")
    usage = install.shutil.disk_usage(tmp_path)
    for free, said in ((1e9, False), (1e5, True)):
        monkeypatch.setattr(
            install.shutil, "disk_usage", lambda path, free=free: usage._replace(free=int(free))
        )
        message = run(Installation(Plan(environments=(tmp_path,)))).message
        assert "Step 1 failed: it returned 1." in message
        assert (f"The disk of {tmp_path} is full: free some space." in message) == said
