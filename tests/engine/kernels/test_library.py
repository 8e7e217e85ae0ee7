"""The compiled kernels: building, choosing and loading them, and their thread pool."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import threading
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from roigs_engine.errors import KernelError
from roigs_engine.kernels import bindings, build, library
from roigs_engine.machine import usable_cores
from roigs_engine.training.losses import photo_loss

ROOT = Path(__file__).resolve().parents[3]
NATIVE = build.native_platform()

# A loop on the pool without torch, which takes seconds to import: the loss of two black images.
USE_POOL = """
import ctypes, os, sys
from roigs_engine.kernels import library
def step():
    width, height = 16, 512
    image, photo = (ctypes.c_float * (3 * width * height))(), bytes(3 * width * height)
    loss, number = (ctypes.c_double * 3)(-1.0), ctypes.c_int64
    library.load().roigs_photo_loss(number(width), number(height), image, photo, None,
                                    ctypes.c_float(0.2), None, loss)
    return loss[2]
"""


def run_python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code],
        cwd=ROOT,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.fixture(autouse=True)
def _clean_caches() -> Iterator[None]:
    """Nothing that a test makes the library believe outlives it."""
    threads = library.threads()
    yield
    library._folder_with_libraries.cache_clear()
    library.load.cache_clear()
    bindings.kernels.cache_clear()
    library.set_threads(threads)


def runnable_isas() -> list[str]:
    folder = library._folder_with_libraries()
    generic = build.library_path(folder, NATIVE, "generic")
    if not generic.is_file():
        return library.available(folder)
    best = library._best_isa(generic)
    return [
        isa
        for isa in build.PLATFORMS[NATIVE].isas
        if library._RANKING.index(isa) <= library._RANKING.index(best)
    ]


def test_every_isa_loads_and_agrees(monkeypatch: pytest.MonkeyPatch) -> None:
    generator = torch.Generator().manual_seed(0)
    photo = torch.randint(0, 256, (37, 50, 3), dtype=torch.uint8, generator=generator)
    render = torch.rand(3, 37, 50, generator=generator)
    wanted: torch.Tensor | None = None
    for isa in runnable_isas():
        monkeypatch.setenv(library.ISA_VARIABLE, isa)
        library.load.cache_clear()
        bindings.kernels.cache_clear()
        assert library.isa() == isa
        image = render.clone().requires_grad_()
        photo_loss(image.permute(1, 2, 0), photo).loss.backward()
        assert image.grad is not None
        if wanted is None:
            wanted = image.grad
        assert (image.grad - wanted).norm() <= 1e-5 * wanted.norm()


def test_the_best_isa_is_the_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(library.ISA_VARIABLE, raising=False)
    assert library.isa() == runnable_isas()[-1]


def test_wrong_isa_says_what_is_there() -> None:
    code = "from roigs_engine.kernels import library; library.load()"
    result = run_python(code, ROIGS_ISA="mmx")
    assert result.returncode != 0
    assert "ROIGS_ISA is 'mmx', but the libraries are: " in result.stderr
    assert runnable_isas()[-1] in result.stderr


def test_isa_beyond_the_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    if "generic" not in library.available(library._folder_with_libraries()):
        pytest.skip("one instruction set on this platform")
    monkeypatch.setattr(library, "_best_isa", lambda path: "generic")
    library.load.cache_clear()
    monkeypatch.delenv(library.ISA_VARIABLE, raising=False)
    assert library.isa() == "generic"
    monkeypatch.setenv(library.ISA_VARIABLE, "avx2")
    library.load.cache_clear()
    with pytest.raises(KernelError, match="best that this processor runs is generic"):
        library.load()


def test_threads() -> None:
    library.set_threads(3)
    assert library.threads() == 3
    library.set_threads(0)
    assert library.threads() == 1
    library.set_threads(None)
    assert library.threads() == usable_cores()


def test_pointer() -> None:
    tensor = torch.zeros(4)
    assert bindings.pointer(tensor[1:]) == tensor.data_ptr() + 4
    assert bindings.pointer(None) is None


def test_process_with_a_busy_pool_ends() -> None:
    code = USE_POOL + (
        "library.set_threads(4)\n"
        "import threading\n"
        "threading.Thread(target=lambda: [step() for _ in range(10**6)], daemon=True).start()\n"
        "for _ in range(20): step()\n"
        "print('end')\n"
    )
    result = run_python(code)
    assert (result.returncode, result.stdout.strip()) == (0, "end"), result.stderr


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_forked_process_has_a_pool_of_its_own() -> None:
    code = USE_POOL + (
        "library.set_threads(4)\n"
        "parent = step()\n"
        "child = os.fork()\n"
        "if not child: os._exit(0 if step() == parent else 3)\n"
        "print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), step() == parent)\n"
    )
    result = run_python(code)
    assert result.stdout.strip() == "0 True", result.stderr


def test_calls_from_several_threads() -> None:
    library.set_threads(3)
    generator = torch.Generator().manual_seed(0)
    photo = torch.randint(0, 256, (150, 90, 3), dtype=torch.uint8, generator=generator)
    render = torch.rand(150, 90, 3, generator=generator)
    wanted = photo_loss(render, photo).loss.item()
    results: list[float] = []

    def work() -> None:
        results.extend(photo_loss(render, photo).loss.item() for _ in range(20))

    workers = [threading.Thread(target=work) for _ in range(4)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert results == [wanted] * 80


@pytest.fixture
def tiny_sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A source folder with one function in place of the kernels."""
    folder = tmp_path / "with space, ünï"
    folder.mkdir()
    (folder / "answer.cpp").write_text(
        'extern "C" __attribute__((visibility("default"))) int answer() { return 42; }\n'
    )
    monkeypatch.setattr(build, "SOURCE_FOLDER", folder)
    return folder


def test_build_is_incremental(
    tiny_sources: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lib = tmp_path / "lib"
    try:
        paths = build.build(lib)
    except build.BuildError as error:
        pytest.skip(f"no compiler: {error}")
    assert [path.is_file() for path in paths] == [True] * len(build.PLATFORMS[NATIVE].isas)
    assert ctypes.CDLL(str(paths[0])).answer() == 42
    assert build.is_current(lib, NATIVE)
    assert sorted(p.suffix for p in paths[0].parent.iterdir()) == sorted(
        [".key", paths[0].suffix] * len(paths)
    )  # no temporary files left

    def compiled(*_: object) -> None:
        raise AssertionError("compiled again")

    with monkeypatch.context() as patch:
        patch.setattr(build, "_run", compiled)
        assert build.build(lib) == paths

    source = tiny_sources / "answer.cpp"
    source.write_text(source.read_text().replace("42", "43"))
    assert not build.is_current(lib, NATIVE)
    elsewhere = tmp_path / "elsewhere"  # a loaded library is not loaded anew from the same path
    lib.rename(elsewhere)
    assert ctypes.CDLL(str(build.build(elsewhere)[0])).answer() == 43

    source.write_text("int broken(\n")
    with pytest.raises(build.BuildError, match=r"answer\.cpp"):
        build.build(elsewhere)
    isas = build.PLATFORMS[NATIVE].isas
    assert all(build.library_path(elsewhere, NATIVE, isa).is_file() for isa in isas)


def test_build_errors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(build.BuildError, match="Unknown target 'amiga'"):
        build.build(tmp_path, target="amiga")
    monkeypatch.setattr(build.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(build.BuildError, match="pip install ziglang"):
        build.build(tmp_path, compiler="zig")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CXX", raising=False)
    with pytest.raises(build.BuildError, match="No C\\+\\+ compiler"):
        build.build(tmp_path)
    assert build.main(["--output", str(tmp_path)]) == 1


def test_missing_library_is_built_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    built: list[Path] = []
    monkeypatch.setattr(library, "PACKAGE_FOLDER", tmp_path / "package")
    monkeypatch.setattr(library, "_user_cache_folder", lambda: tmp_path / "cache")
    monkeypatch.setattr(build, "build", built.append)
    for writable, wanted in ((True, "package"), (False, "cache")):
        monkeypatch.setattr(library, "_is_writable", lambda folder, w=writable: w)
        library._folder_with_libraries.cache_clear()
        assert library._folder_with_libraries() == tmp_path / wanted
        assert built[-1] == tmp_path / wanted


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="owners and modes of POSIX")
def test_a_cache_that_others_can_change_is_not_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(library, "user_cache", lambda: tmp_path / "roigs")
    kernels = tmp_path / "roigs" / "kernels" / "1"
    kernels.mkdir(parents=True)
    (kernels / "linux").mkdir()
    code = kernels / "linux" / "kernels.so"
    code.write_bytes(b"code")
    library.refuse_others_code(kernels)
    library.refuse_others_code(kernels / "not yet there")
    for place in (code, kernels, tmp_path / "roigs", tmp_path):
        place.chmod(place.stat().st_mode | 0o002)
        with pytest.raises(KernelError, match=f"Others can change {place}, from which") as caught:
            library.refuse_others_code(kernels)
        assert "XDG_CACHE_HOME" in (caught.value.hint or "")
        place.chmod(place.stat().st_mode & ~0o002)
    monkeypatch.setattr(library.os, "getuid", lambda: 12345)
    if code.stat().st_uid:
        with pytest.raises(KernelError, match="Others can change"):
            library.refuse_others_code(kernels)


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="owners and modes of POSIX")
@pytest.mark.parametrize("linked", ["roigs", "roigs/kernels", "roigs/kernels/1/kernels.so", ""])
def test_links_that_others_can_change_are_not_followed_to_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, linked: str
) -> None:
    home, shared, real = tmp_path / "home", tmp_path / "shared", tmp_path / "real"
    shared.mkdir()
    (home / "roigs/kernels/1").mkdir(parents=True)
    (home / "roigs/kernels/1/kernels.so").write_bytes(b"code")
    (home / linked).rename(real)
    (shared / "way").symlink_to(real)  # a link to a link
    (home / linked).symlink_to(shared / "way")
    monkeypatch.setattr(library, "user_cache", lambda: home / "roigs")
    library.refuse_others_code(home / "roigs/kernels/1")
    shared.chmod(0o777)
    with pytest.raises(KernelError, match=f"Others can change {shared}, from which"):
        library.refuse_others_code(home / "roigs/kernels/1")
    shared.chmod(0o755)
    if linked and os.getuid() == 0:
        os.chown(shared, 12345, -1)
        with pytest.raises(KernelError, match=f"Others can change {shared}, from which"):
            library.refuse_others_code(home / "roigs/kernels/1")


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="owners and modes of POSIX")
@pytest.mark.parametrize(
    ("name", "own", "members", "shared"),
    [
        ("ann", True, [], False),
        ("ann", True, ["ann"], False),
        ("ann", True, ["ann", "bob"], True),
        ("staff", True, [], True),  # others may have it as theirs without being listed
        ("ann", False, [], True),
        (None, True, [], True),  # a group without a record
    ],
)
def test_a_cache_that_a_group_can_change_is_loaded_if_nobody_else_is_in_it(
    name: str | None,
    own: bool,
    members: list[str],
    shared: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def record(number: int) -> SimpleNamespace:
        if name is None:
            raise KeyError(number)
        return SimpleNamespace(gr_name=name, gr_mem=members)

    user = SimpleNamespace(pw_name="ann", pw_gid=4000 if own else 4001)
    monkeypatch.setattr("pwd.getpwuid", lambda number: user)
    monkeypatch.setattr("grp.getgrgid", record)
    library._is_shared.cache_clear()
    try:
        assert library._is_shared(4000) == shared
        assert not library._is_shared(0)
    finally:
        library._is_shared.cache_clear()
    monkeypatch.setattr(library, "user_cache", lambda: tmp_path / "roigs")
    monkeypatch.setattr(library, "_is_shared", lambda group: shared)
    (tmp_path / "roigs").mkdir()
    (tmp_path / "roigs").chmod(0o775)
    if shared:
        with pytest.raises(KernelError, match="Others can change"):
            library.refuse_others_code(tmp_path / "roigs")
    else:
        library.refuse_others_code(tmp_path / "roigs")


def test_old_kernels_where_warnings_are_errors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(library, "available", lambda folder: ["generic"])
    monkeypatch.setattr(build, "read_keys", lambda *_: ("older", build.interface_key()))
    with pytest.warns(UserWarning, match="older than their sources"):
        library._check_age(tmp_path)
    warnings.simplefilter("error")
    with pytest.raises(KernelError, match="compiled kernels are older than their sources"):
        library._check_age(tmp_path)


def test_missing_library_and_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(folder: Path) -> None:
        raise build.BuildError("No C++ compiler found.")

    monkeypatch.setattr(library, "PACKAGE_FOLDER", tmp_path / "package")
    monkeypatch.setattr(library, "_user_cache_folder", lambda: tmp_path / "cache")
    monkeypatch.setattr(build, "build", fail)
    library._folder_with_libraries.cache_clear()
    library.load.cache_clear()
    with pytest.raises(KernelError, match="No C\\+\\+ compiler found") as raised:
        library.load()
    assert "python" in raised.value.hint
    assert "-m roigs_engine.kernels.build" in raised.value.hint


def test_libraries_of_other_sources(
    tiny_sources: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "package"
    for isa in build.PLATFORMS[NATIVE].isas:
        path = build.library_path(folder, NATIVE, isa)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
        path.with_name(path.name + ".key").write_text(
            f"{build.source_key()}\n{build.interface_key()}"
        )
    monkeypatch.setattr(library, "PACKAGE_FOLDER", folder)
    library._folder_with_libraries.cache_clear()
    assert library._folder_with_libraries() == folder  # no warning: these are errors in tests

    (tiny_sources / "answer.cpp").write_text("int answer() { return 43; }\n")
    library._folder_with_libraries.cache_clear()
    with pytest.warns(UserWarning, match=r"older than their sources.*kernels\.build"):
        assert library._folder_with_libraries() == folder

    (tiny_sources / build.INTERFACE[0]).write_text("int answer(int);\n")
    library._folder_with_libraries.cache_clear()
    with pytest.raises(KernelError, match="another version") as raised:
        library._folder_with_libraries()
    assert "-m roigs_engine.kernels.build" in raised.value.hint
