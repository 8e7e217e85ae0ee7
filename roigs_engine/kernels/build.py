"""The build of the C++ kernels: one shared library per instruction set of a platform.

    python -m roigs_engine.kernels.build [--target PLATFORM] [--compiler zig|cxx]

The compiler is that of the `ziglang` wheel if it is installed (it also cross-compiles), otherwise
the system's. The module imports only the standard library, nothing of this package, because
setup.py runs it without numpy and torch.
"""

from __future__ import annotations

import sys

if __name__ == "__main__" and not sys.flags.safe_path:
    del sys.path[0]  # `-m` adds the working folder, whose files may be untrusted

import argparse
import getpass
import hashlib
import importlib.util
import os
import platform
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

SOURCE_FOLDER = Path(__file__).resolve().parent
INTERFACE = ("roigs.h", "types.h")  # what callers of the kernels depend on


class BuildError(RuntimeError):
    """The kernels cannot be built; the text is for users."""


@dataclass(frozen=True, kw_only=True)
class Platform:
    """An operating system and processor family."""

    triple: str  # name for the bundled compiler
    suffix: str
    isas: Mapping[str, str]  # name of the instruction set -> processor level of the x86-64 psABI


_X64 = {"generic": "x86-64", "avx2": "x86-64-v3", "avx512": "x86-64-v4"}
_ARM64 = {"neon": ""}

# The glibc version in a triple is the oldest that the library runs on.
PLATFORMS = {
    "linux-x64": Platform(triple="x86_64-linux-gnu.2.17", suffix=".so", isas=_X64),
    "linux-arm64": Platform(triple="aarch64-linux-gnu.2.17", suffix=".so", isas=_ARM64),
    "windows-x64": Platform(triple="x86_64-windows-gnu", suffix=".dll", isas=_X64),
    "macos-x64": Platform(triple="x86_64-macos.11.0", suffix=".dylib", isas=_X64),
    "macos-arm64": Platform(triple="aarch64-macos.11.0", suffix=".dylib", isas=_ARM64),
}

# Not -ffast-math: NaN and infinity keep their meaning, so that broken gradients are noticed. The
# flags allow only what vectorisation needs (no errno, no floating-point traps), and fused
# multiply-add. The compiler reorders no sums: the sources spell out their vector lanes.
FLAGS = (
    *("-std=c++17", "-O3", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=fast"),
    *("-fno-exceptions", "-fno-rtti", "-fvisibility=hidden"),
)

# See runtime.cpp: its `new` and `delete` are only for the kernels, not for the whole process.
_NO_CXX_LIBRARY = ("-DROIGS_NO_CXX_LIBRARY=1", "-fvisibility-global-new-delete=force-hidden")

# Not for other compilers: gcc warns about its own vector headers (gcc bug 105593).
_WARNINGS = ("-Wall", "-Wextra")


def native_platform() -> str:
    """The platform of this Python, a key of `PLATFORMS`; BuildError: it is not supported."""
    system = {"linux": "linux", "win32": "windows", "darwin": "macos"}.get(sys.platform)
    machine = {"x86_64": "x64", "amd64": "x64", "aarch64": "arm64", "arm64": "arm64"}.get(
        platform.machine().lower()
    )
    name = f"{system}-{machine}"
    if name not in PLATFORMS:
        raise BuildError(f"No kernels for {sys.platform} on {platform.machine()}.")
    return name


def library_path(folder: Path, target: str, isa: str) -> Path:
    """The path of an instruction set's library, below an output folder."""
    return folder / target / f"roigs_{isa}{PLATFORMS[target].suffix}"


def source_key() -> str:
    """A hash of the inputs of the libraries: their sources, and this file with its flags."""
    return _digest("*.cpp", "*.h", "build.py")


def interface_key() -> str:
    """A hash of the interface: the functions and structs that callers use."""
    return _digest(*INTERFACE)


def is_current(folder: Path, target: str) -> bool:
    """Whether all libraries of a platform exist and match the current sources."""
    key = source_key()
    return all(
        library_path(folder, target, isa).is_file() and read_keys(folder, target, isa)[0] == key
        for isa in PLATFORMS[target].isas
    )


def read_keys(folder: Path, target: str, isa: str) -> tuple[str, str]:
    """`source_key` and `interface_key` of a library's build; empty if unknown."""
    try:
        text = _key_file(library_path(folder, target, isa)).read_text(encoding="ascii")
    except OSError:
        return "", ""
    source, _, interface = text.partition("\n")
    return source, interface


def build(
    folder: Path = SOURCE_FOLDER / "lib", *, target: str = "native", compiler: str = "auto"
) -> list[Path]:
    """Build all libraries unless they are current; returns their paths. Raises `BuildError`.

    A library gets its name only when it is complete. So several processes may build at the same
    time.
    """
    name = native_platform() if target == "native" else target
    if name not in PLATFORMS:
        raise BuildError(f"Unknown target {name!r}: choose from {', '.join(PLATFORMS)}.")
    paths = [library_path(folder, name, isa) for isa in PLATFORMS[name].isas]
    if is_current(folder, name):
        return paths
    # Before compiling, so that sources edited meanwhile make the result outdated.
    keys = f"{source_key()}\n{interface_key()}"
    with tempfile.TemporaryDirectory(prefix="roigs-build-") as scratch:
        built = compile_all(_sources("*.cpp"), Path(scratch), name, compiler)
        for isa, temporary in built.items():
            _install(temporary, library_path(folder, name, isa), keys)
    return paths


def _sources(*patterns: str) -> list[Path]:
    return sorted(path for pattern in patterns for path in SOURCE_FOLDER.glob(pattern))


def _digest(*patterns: str) -> str:
    digest = hashlib.sha256()
    for path in _sources(*patterns):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def _key_file(library: Path) -> Path:
    return library.with_name(library.name + ".key")


def _compiler_command(compiler: str, target: str) -> tuple[list[str], bool]:
    """The command that compiles for `target`, and whether it is the bundled compiler."""
    if compiler in ("auto", "zig"):
        spec = importlib.util.find_spec("ziglang")
        if spec is not None and spec.submodule_search_locations:
            # The binary itself: it starts faster than `python -m ziglang`.
            zig = shutil.which("zig", path=next(iter(spec.submodule_search_locations)))
            if zig:
                return [zig, "c++"], True
        if compiler == "zig":
            raise BuildError("The package ziglang is not installed: run `pip install ziglang`.")
    for candidate in (os.environ.get("CXX", ""), "c++", "g++", "clang++"):
        name, *options = candidate.split() or [""]
        if program := _program(name):
            if target != native_platform():
                raise BuildError(f"Building for {target} here needs `pip install ziglang`.")
            return [program, *options], False
    raise BuildError("No C++ compiler found: run `pip install ziglang`, or set CXX.")


def _program(name: str) -> str | None:
    """The full path of a compiler, but never one in the working folder, which may be untrusted.

    `shutil.which` and Windows search there first, and in relative entries of PATH.
    """
    if not name or os.path.dirname(name):
        return shutil.which(name) if os.path.isabs(name) else None
    folders = filter(os.path.isabs, os.environ.get("PATH", "").split(os.pathsep))
    file = f"{name}.exe" if os.name == "nt" and not name.lower().endswith(".exe") else name
    paths = (os.path.join(folder, file) for folder in folders)
    return next((p for p in paths if os.path.isfile(p) and os.access(p, os.X_OK)), None)


def compile_all(
    sources: Sequence[Path], folder: Path, target: str, compiler: str = "auto"
) -> dict[str, Path]:
    """Compile sources for a platform in parallel; returns instruction set -> library in `folder`.

    Raises `BuildError`. Benchmarks call this with their own sources.
    """
    command, is_zig = _compiler_command(compiler, target)
    spec = PLATFORMS[target]
    environment = dict(os.environ)
    if is_zig:
        cache = str(_zig_cache())
        environment.update(ZIG_GLOBAL_CACHE_DIR=cache, ZIG_LOCAL_CACHE_DIR=cache)
        common = [*command, "-target", spec.triple, *FLAGS, *_NO_CXX_LIBRARY, *_WARNINGS]
        # All links have the same processor model, so zig builds its own libraries only once.
        link = [command[0], "cc", "-target", spec.triple, "-nostdlib++", "-s", "-shared"]
    else:
        common = [*command, *FLAGS]
        link = [*command, "-shared"]
    if not target.startswith("windows"):
        common.append("-fPIC")
        link.append("-pthread")
    if target.startswith("linux"):
        link.append("-Wl,-z,defs")  # undefined symbols fail here, not when they are called

    with ThreadPoolExecutor(max_workers=os.cpu_count() or 1) as workers:
        objects: dict[str, list[Path]] = {}
        jobs = []
        for isa in spec.isas:
            flags = _isa_flags(isa, spec.isas[isa], is_zig)
            objects[isa] = []
            for source in sources:
                output = folder / f"{source.stem}_{isa}.o"
                objects[isa].append(output)
                arguments = [*common, *flags, "-c", str(source), "-o", str(output)]
                jobs.append(workers.submit(_run, arguments, environment))
        for job in jobs:
            job.result()
        libraries = {isa: library_path(folder, target, isa) for isa in spec.isas}
        for isa, library in libraries.items():
            library.parent.mkdir(exist_ok=True)
            # A macOS library contains its name. Without this, it would be the scratch file's.
            macos_name = f"-Wl,-install_name,@rpath/{library.name}"
            name = [macos_name] if target.startswith("macos") else []
            # One after the other, because zig builds its own libraries for the first one.
            _run([*link, *name, *map(str, objects[isa]), "-o", str(library)], environment)
    return libraries


def _isa_flags(isa: str, level: str, is_zig: bool) -> list[str]:
    if not level:
        return []
    flags = ["-mcpu=" + level.replace("-", "_") if is_zig else "-march=" + level]
    if isa == "avx512":
        # clang and gcc prefer 256-bit vectors even if 512-bit ones exist, because early AVX-512
        # processors lowered their clock. For the kernels' dense arithmetic, full width is faster.
        flags.append("-mprefer-vector-width=512")
    return flags


def _run(command: list[str], environment: dict[str, str]) -> None:
    result = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if result.returncode:
        raise BuildError(f"{' '.join(command)}\n{result.stderr.strip() or result.stdout.strip()}")
    if result.stderr.strip():
        print(result.stderr.strip(), file=sys.stderr)


def _zig_cache() -> Path:
    """This user's folder for the compiler's cache, outside the project and the home folder."""
    user = os.getuid() if hasattr(os, "getuid") else getpass.getuser()
    folder = Path(tempfile.gettempdir()) / f"roigs-zig-cache-{user}"
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    if hasattr(os, "getuid") and (status.st_uid != os.getuid() or status.st_mode & 0o022):
        return Path(tempfile.mkdtemp(prefix="roigs-zig-cache-"))
    return folder


def _install(built: Path, library: Path, keys: str) -> None:
    library.parent.mkdir(parents=True, exist_ok=True)
    for content, path in ((built.read_bytes(), library), (keys.encode(), _key_file(library))):
        handle, temporary = tempfile.mkstemp(dir=library.parent, prefix=".new-")
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
        os.chmod(temporary, 0o755 if path is library else 0o644)
        os.replace(temporary, path)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else None)
    parser.add_argument("--target", default="native", choices=["native", *PLATFORMS])
    parser.add_argument("--compiler", default="auto", choices=["auto", "zig", "cxx"])
    parser.add_argument("--output", type=Path, default=SOURCE_FOLDER / "lib", metavar="FOLDER")
    options = parser.parse_args(arguments)
    try:
        paths = build(options.output, target=options.target, compiler=options.compiler)
    except BuildError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    for path in paths:
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
