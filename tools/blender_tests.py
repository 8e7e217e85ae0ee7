"""Runs the add-on's tests inside a real Blender.

    python tools/blender_tests.py [--blender PROGRAM | --suite SUITE] [arguments of pytest]

A suite that is a number, such as `5.3`, is a version of Blender as a Python module, from PyPI. It
is put into .blender/5.3, once, and needs Python 3.13: this machine's, or Debian's (below). It has
no window. Other suites are Debian's.

Without `--blender`, a Blender is put together from Debian's packages in .blender/SUITE, once: they
are downloaded and unpacked, nothing is installed. `trixie` has Blender 4.3, `sid` a later one. That
needs apt-get and dpkg-deb; elsewhere, name a Blender of blender.org with `--blender`. Its Python
gets pytest from a folder beside it. The engine runs under the Python that runs this script, unless
ROIGS_ENGINE_PYTHON names another one.
"""

from __future__ import annotations

import argparse
import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CACHE = ROOT / ".blender"
PACKAGES = ("blender", "python3-numpy", "libegl1", "libgl1", "libgl1-mesa-dri", "libegl-mesa0")
MIRROR = "http://deb.debian.org/debian"
LOADER = "ld-linux-x86-64.so.2"
EXECUTABLE = stat.S_IXUSR | stat.S_IXGRP | stat.S_IXOTH

MODULE_PYTHON = "3.13"
"""Python version of Blender's module, from Blender 5.1 on."""
MODULE_PACKAGES = ("numpy>=2.2,<3", "cattrs")
"""Packages that the module's own scripts import."""

# Starts a program of another system with that system's C library. The program's name stays the
# same, because Python finds its files by it. Mesa gets its own cache: it maps the cache's file into
# memory, and another version of Mesa would truncate the file (SIGBUS).
PROGRAM = """#!/bin/sh
here='{root}'
{own}
export __EGL_VENDOR_LIBRARY_DIRS="$here/usr/share/glvnd/egl_vendor.d" LIBGL_DRIVERS_PATH="{lib}/dri"
export GBM_BACKENDS_PATH="{lib}/gbm" LIBGL_ALWAYS_SOFTWARE=1
export MESA_SHADER_CACHE_DIR="$here/var/cache"
exec '{lib}/{loader}' --library-path "$LIBRARIES_FIRST"'{paths}' --argv0 "$0" '{binary}' "$@"
"""
# Only for Blender: as variables of that Python, they would mislead Blender's module.
BLENDERS = """\
export BLENDER_SYSTEM_PYTHON="$here/usr" BLENDER_SYSTEM_RESOURCES="$here/usr/share/blender"
export BLENDER_SYSTEM_SCRIPTS="$here/usr/share/blender/scripts"
export BLENDER_SYSTEM_DATAFILES="$here/usr/share/blender/datafiles"
"""
MODULE_PROGRAM = """#!/bin/sh
export PYTHONPATH='{packages}' PYTHONNOUSERSITE=1 LIBRARIES_FIRST='{packages}/bpy/lib:'
exec '{python}' "$@"
"""


def main() -> int:
    """Create what is missing and run the tests; returns pytest's exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--blender", help="the Blender to use")
    parser.add_argument("--suite", default="trixie", help="Debian's, or the number of a version")
    args, rest = parser.parse_known_args()
    environment = {
        "ROIGS_ENGINE_PYTHON": sys.executable,
        **os.environ,
        "ROIGS_PYTEST": str(pytest_folder()),
    }
    if args.suite[:1].isdigit() and not args.blender:
        command = [str(blender_module(args.suite))]
    else:
        blender = args.blender or str(debian_blender(args.suite))
        environment["ROIGS_BLENDER"] = str(Path(shutil.which(blender) or blender).absolute())
        command = [blender, "-b", "--factory-startup", "--python-exit-code", "1", "--python"]
    command += [str(ROOT / "tests" / "blender" / "run.py"), "--", *rest]
    return subprocess.run(command, env=environment, check=False).returncode


def pytest_folder() -> Path:
    """A folder with pytest and its dependencies: pure Python, so that any Blender can use it."""
    return install(CACHE / "for_tests", "pytest", "filelock")


def install(folder: Path, *arguments: str) -> Path:
    """Install packages into a folder with these arguments of pip, unless the folder exists."""
    if not folder.is_dir():
        fresh = folder.with_suffix(".part")
        shutil.rmtree(fresh, ignore_errors=True)
        pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "--quiet"]
        subprocess.run([*pip, "--target", str(fresh), *arguments], check=True)
        fresh.rename(folder)
    return folder


def blender_module(version: str) -> Path:
    """A Python whose module `bpy` is Blender of this version."""
    program = CACHE / version / "python"
    if not program.exists():
        python = module_python()
        print(f"Blender {version} from PyPI: downloading to {program.parent}", file=sys.stderr)
        of_python = ("--python-version", MODULE_PYTHON, "--only-binary=:all:")
        wanted = (f"bpy=={version}.*", *MODULE_PACKAGES)
        packages = install(program.with_name("packages"), *of_python, *wanted)
        program.write_text(MODULE_PROGRAM.format(packages=packages, python=python))
        program.chmod(program.stat().st_mode | EXECUTABLE)
    return program


def module_python() -> Path:
    """A Python for Blender's module: this machine's, or Debian's."""
    name = f"python{MODULE_PYTHON}"
    own = shutil.which(name)  # may be a placeholder that does not run
    if own and not subprocess.run([own, "-c", ""], check=False, capture_output=True).returncode:
        return Path(own)
    return debian_blender("trixie").parent / "usr" / "bin" / name


def debian_blender(suite: str) -> Path:
    """The program `blender` in a folder with a Debian suite's packages; creates the folder."""
    folder = CACHE / suite
    if not (folder / "blender").exists():
        for tool in ("apt-get", "dpkg-deb"):
            if not shutil.which(tool):
                raise SystemExit(f"error: {tool} is missing. Name a Blender with --blender.")
        shutil.rmtree(folder, ignore_errors=True)
        print(f"Blender from Debian {suite}: downloading to {folder}", file=sys.stderr, flush=True)
        packages = download(suite, folder / "apt")
        for package in packages:
            unpack(package, folder)
        shutil.rmtree(folder / "apt")
        make_programs(folder)
    return folder / "blender"


def mirror() -> str:
    """Debian's mirror that this machine uses, or the general one."""
    sources = Path("/etc/apt/sources.list.d/debian.sources")
    lines = sources.read_text(encoding="utf-8").splitlines() if sources.is_file() else []
    return next((line.split()[1] for line in lines if line.startswith("URIs:")), MIRROR)


def download(suite: str, folder: Path) -> list[Path]:
    """Download Blender and all packages that it needs, with apt's state in `folder`."""
    for part in ("lists/partial", "cache/archives/partial", "none"):
        (folder / part).mkdir(parents=True)
    (folder / "status").touch()
    key = "/usr/share/keyrings/debian-archive-keyring.gpg"
    (folder / "sources").write_text(f"deb [signed-by={key}] {mirror()} {suite} main\n")
    settings = {
        "Dir::State": folder,
        "Dir::State::lists": folder / "lists",
        "Dir::State::status": folder / "status",
        "Dir::Cache": folder / "cache",
        "Dir::Etc::sourcelist": folder / "sources",
        "Dir::Etc::sourceparts": folder / "none",
        "Dir::Etc::preferencesparts": folder / "none",
        "APT::Install-Recommends": "false",
        "APT::Sandbox::User": "",
        "Acquire::Languages": "none",
        "Acquire::Check-Valid-Until": "false",
        "Debug::NoLocking": "true",
    }
    apt = ["apt-get", "-qq", "-y", *(f"-o{name}={value}" for name, value in settings.items())]
    subprocess.run([*apt, "update"], check=True)
    subprocess.run(
        [*apt, "--download-only", "install", *PACKAGES], check=True, stdout=subprocess.DEVNULL
    )
    return sorted((folder / "cache" / "archives").glob("*.deb"))


def unpack(package: Path, folder: Path) -> None:
    """Unpack a package into the folder, in which /lib and similar folders are links into /usr."""
    for name in ("bin", "sbin", "lib", "lib64"):
        (folder / "usr" / name).mkdir(parents=True, exist_ok=True)
        if not (folder / name).is_symlink():
            (folder / name).symlink_to(f"usr/{name}")
    skipped = [f"--exclude=./usr/share/{name}" for name in ("doc", "man", "locale", "icons")]
    tar = ["tar", "-x", "-C", str(folder), "--no-same-owner", "--keep-directory-symlink", *skipped]
    with subprocess.Popen(
        ["dpkg-deb", "--fsys-tarfile", str(package)], stdout=subprocess.PIPE
    ) as files:
        subprocess.run(tar, stdin=files.stdout, check=True)


def make_programs(folder: Path) -> None:
    """Replace Blender and its Python by scripts that start them from this folder."""
    lib = folder / "usr" / "lib" / "x86_64-linux-gnu"
    # BLAS, PulseAudio and others have their own folders.
    folders = [lib, lib.parent, *sorted(path for path in lib.iterdir() if any(path.glob("*.so*")))]
    python = min((folder / "usr" / "bin").glob("python3.[0-9]*"))
    for program in (folder / "usr" / "bin" / "blender", python):
        binary = program.with_name(f"{program.name}.bin")
        program.rename(binary)
        values = {"root": folder, "lib": lib, "loader": LOADER, "binary": binary}
        values["own"] = BLENDERS if program.name == "blender" else ""
        paths = ":".join(map(str, folders))
        program.write_text(PROGRAM.format(**values, paths=paths))
        program.chmod(program.stat().st_mode | EXECUTABLE)
    (folder / "blender").symlink_to("usr/bin/blender")


if __name__ == "__main__":
    sys.exit(main())
