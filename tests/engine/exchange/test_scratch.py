"""A disk without room is one line, also where a library writes a file of its own."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.cli import main
from roigs_engine.errors import EngineError
from roigs_engine.exchange import formats
from roigs_engine.exchange.libraries import scratch
from roigs_engine.rasterize.image_files import save_light
from tests.engine.exchange.format_cases import arrays, needed
from tests.engine.other_process import in_the_middle

SUFFIXES = (".glb", ".spz", ".usda", ".usdc", ".usdz", ".html")


@pytest.fixture
def small_disk() -> Iterator[None]:
    """No file of this process may be longer than 20,000 bytes."""
    resource = pytest.importorskip("resource", reason="limits the size of files as Unix does")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_full_disk_is_one_line(
    suffix: str, tmp_path: Path, request: pytest.FixtureRequest, capfd: pytest.CaptureFixture[str]
) -> None:
    needed(formats.format_of(tmp_path / f"a{suffix}"))
    source, out = tmp_path / "in.ply", tmp_path / "out" / f"a{suffix}"
    formats.write(source, arrays(4000))
    out.parent.mkdir()
    out.write_bytes(b"before")
    request.getfixturevalue("small_disk")
    status, said = main(["convert", str(source), str(out)]), capfd.readouterr().err
    assert status == 2 and said.startswith("error: ")
    assert said.count("\n") == 1, said
    assert "Free some space" in said
    assert [path.name for path in out.parent.iterdir()] == [out.name]
    assert out.read_bytes() == b"before"


@pytest.mark.parametrize("suffix", [".spz", ".usdc", ".html"])
def test_without_a_folder_for_temporary_files(
    suffix: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    needed(formats.format_of(tmp_path / f"a{suffix}"))

    def missing() -> str:
        raise FileNotFoundError(2, "No usable temporary directory found")

    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setattr(tempfile, "_get_default_tempdir", missing)
    with pytest.raises(EngineError, match="set TMPDIR"):
        formats.write(tmp_path / f"a{suffix}", arrays())
    assert not list(tmp_path.iterdir())


def test_full_memory_is_not_a_full_disk() -> None:
    with pytest.raises(RuntimeError), scratch("SPZ"):
        raise RuntimeError("std::bad_alloc")


KILLED = """\
import sys
from pathlib import Path
from roigs_engine.formats.files import atomic_write
with atomic_write(Path(sys.argv[1])) as file:
    file.write(b"half")
    file.flush()
    print("half", flush=True)
    sys.stdin.read()
"""


@pytest.mark.parametrize("suffix", [".ply", ".splat"])
def test_the_next_export_removes_what_a_killed_one_left(suffix: str, tmp_path: Path) -> None:
    out = tmp_path / f"a{suffix}"
    with in_the_middle(KILLED, out, "half") as process:
        process.kill()
    (tmp_path / f".b{suffix}.12-0123abcd.part").touch()  # of another file
    with in_the_middle(KILLED, tmp_path / "c", "half"):  # still writes
        (tmp_path / f".{out.name}.12-0123abcd.part").touch()
        assert len(list(tmp_path.iterdir())) == 2
        formats.write(out, arrays())
        assert len(list(tmp_path.iterdir())) == 2
        assert len(formats.read(out)["means"]) == 400


def test_light_on_a_full_disk_is_one_line(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """OpenCV writes it through a file of its own."""
    pytest.importorskip("cv2")
    light = np.random.default_rng(0).random((128, 256, 3), np.float32)
    request.getfixturevalue("small_disk")
    with pytest.raises(EngineError, match="cannot be written"):
        save_light(tmp_path / "a.hdr", light)
    assert not list(tmp_path.iterdir())
