"""Train on a cluster: the same job, its work elsewhere."""

from __future__ import annotations

import os
import subprocess
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

from tests.addon.scenes import command_line, options, ready

pytestmark = pytest.mark.blender


def use(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Choose a cluster on the preferences page."""
    from roigs_addon import settings

    chosen = replace(settings.get(), train_on=settings.CLUSTER, cluster=address, threads=3)
    monkeypatch.setattr(settings, "get", lambda: chosen)


def test_the_engine_is_given_the_address(
    blender: ModuleType,
    addon: ModuleType,
    project: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from roigs_addon.jobs import train_job
    from roigs_addon.scene import lookup

    scene = ready(blender, project, tmp_path / "run")
    assert "--cluster" not in train_job.spec(scene, lookup.rois(scene)).arguments
    use(" ray://10.0.0.1:10001 ", monkeypatch)
    arguments = train_job.spec(scene, lookup.rois(scene)).arguments
    assert arguments[-2:] == ["--cluster", "ray://10.0.0.1:10001"]
    assert "threads" not in options(tmp_path / "run", "train")  # of this computer
    use("", monkeypatch)
    assert train_job.spec(scene, lookup.rois(scene)).arguments[-2:] == ["--cluster", "auto"]


def has_ray(engine) -> bool:
    find = [str(engine.python), "-c", "import ray"]
    return subprocess.run(find, env=engine.environment(), capture_output=True).returncode == 0


def test_a_cluster_that_is_not_there_is_one_line(
    blender: ModuleType, engine, project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ready(blender, project, tmp_path / "run")
    use("127.0.0.1:1", monkeypatch)
    known = "There is no Ray cluster at 127.0.0.1:1 "
    said = known if has_ray(engine) else "Train On: Cluster needs Ray, which is not installed in"
    with pytest.raises(RuntimeError, match=said) as error:
        blender.ops.roigs.train_roi()
    assert len(str(error.value).strip().splitlines()) == 1
    if said != known:
        assert "or choose Train On: This Computer." in str(error.value)


@pytest.mark.slow
@pytest.mark.parametrize("test_every", [0, 2])
def test_a_real_ray_gives_what_this_computer_gives(
    blender: ModuleType,
    engine,
    project: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    test_every: int,
) -> None:
    if not has_ray(engine):
        pytest.skip("Ray is not installed (the extra `cluster`)")
    scene = ready(blender, project, tmp_path / "run")
    scene.roigs.test_every = test_every
    monkeypatch.setitem(os.environ, "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")
    use("local", monkeypatch)
    assert blender.ops.roigs.train_roi() == {"FINISHED"}
    assert scene.roigs.root.children_recursive  # with the Gaussians among them
    command = "run" if test_every else "train"
    asked = tmp_path / "run" / "blender" / "train.json"
    command_line(engine, command, asked, "--run-dir", tmp_path / "here")
    for name in ("result.ply", "background.ply", "rois/thing.ply"):
        assert (tmp_path / "run" / name).read_bytes() == (tmp_path / "here" / name).read_bytes()
