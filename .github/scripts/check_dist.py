"""Checks what a release consists of.

    python .github/scripts/check_dist.py [DIST] [--complete] [--tag v1.2.3] [--notes]

Reads every wheel, source archive and Blender extension in the folder DIST. The name must be of this
version. The engine's modules, the kernels' sources and the compiled kernels of the platform must be
there, and no other platform's. The listing of the extension's repository must name the extension as
it is there. `--complete`: DIST must hold all files of a release. `--tag`: the
tag must be the version of the engine and the add-on, and the changelog must have a part for it.
`--notes` prints that part. The script needs nothing but Python.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import importlib.util
import json
import re
import struct
import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parents[2]
KERNELS = "roigs_engine/kernels/"


class CheckError(Exception):
    """Something is not as it must be in a release; the text is one line."""


def load_builder() -> ModuleType:
    """roigs_engine/kernels/build.py, without importing the package and what it depends on."""
    name = "roigs_kernel_builder"
    spec = importlib.util.spec_from_file_location(name, ROOT / KERNELS / "build.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def assigned(path: Path, name: str) -> object:
    """The literal that a Python file assigns to a name, without running the file."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name:
            return ast.literal_eval(node.value)
    raise CheckError(f"{path.name} does not set {name}")


def engine_version() -> str:
    """The engine's version, which is also the package's."""
    return str(assigned(ROOT / "roigs_engine" / "__init__.py", "__version__"))


def wheel_tags() -> dict[str, str]:
    """Platform tag of a wheel -> the kernels' platform."""
    platforms = assigned(ROOT / "setup.py", "WHEEL_PLATFORMS")
    assert isinstance(platforms, dict)
    return {tag: target for target, tag in platforms.items()}


def libraries(targets: Iterable[str]) -> set[str]:
    """The compiled kernels of some platforms, as paths in a wheel or an extension."""
    builder = load_builder()
    folder = Path(KERNELS, "lib")
    return {
        builder.library_path(folder, target, isa).as_posix()
        for target in targets
        for isa in builder.PLATFORMS[target].isas
    }


def machine(data: bytes) -> str:
    """The platform that a compiled library is for, from its header; empty if it is none."""
    if data[:4] == b"\x7fELF":
        return {0x3E: "linux-x64", 0xB7: "linux-arm64"}.get(
            struct.unpack_from("<H", data, 18)[0], ""
        )
    if data[:4] == b"\xcf\xfa\xed\xfe":
        kinds = {0x0100_0007: "macos-x64", 0x0100_000C: "macos-arm64"}
        return kinds.get(struct.unpack_from("<I", data, 4)[0], "")
    if data[:2] == b"MZ":
        (start,) = struct.unpack_from("<I", data, 0x3C)
        return {0x8664: "windows-x64"}.get(struct.unpack_from("<H", data, start + 4)[0], "")
    return ""


def check_kernels(archive: zipfile.ZipFile, targets: list[str]) -> None:
    """The archive holds the compiled kernels of these platforms, each for its own machine."""
    there = {name for name in archive.namelist() if name.startswith(f"{KERNELS}lib/")}
    there = {name for name in there if not name.endswith((".key", "/"))}
    wanted = libraries(targets)
    if there != wanted:
        raise CheckError(f"missing {sorted(wanted - there)}, not expected {sorted(there - wanted)}")
    for name in sorted(there):
        if machine(archive.read(name)) != Path(name).parent.name:
            raise CheckError(f"{name} is not a library for {Path(name).parent.name}")


def check_sources(names: Iterable[str]) -> None:
    """Every module of the engine is there, and the kernels' sources: they may be compiled later."""
    engine = ROOT / "roigs_engine"
    wanted = [path for path in engine.rglob("*") if path.suffix in (".py", ".cpp", ".cu", ".h")]
    missing = {path.relative_to(ROOT).as_posix() for path in wanted} - set(names)
    if missing:
        raise CheckError(f"missing {sorted(missing)}")


def check_wheel(path: Path) -> str:
    """A wheel; returns the kernels' platform."""
    match = re.fullmatch(r"roigs-(.+)-py3-none-(\w+)\.whl", path.name)
    if match is None or match[1] != engine_version() or match[2] not in wheel_tags():
        raise CheckError("not a wheel of this version for a known platform")
    target = wheel_tags()[match[2]]
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        (info,) = (name for name in names if name.endswith(".dist-info/WHEEL"))
        tags = re.findall(r"^Tag: (.+)$", archive.read(info).decode(), flags=re.MULTILINE)
        if tags != [f"py3-none-{match[2]}"]:
            raise CheckError(f"its tags are {tags}")
        strange = {name.partition("/")[0] for name in names} - {"roigs_engine"}
        if any(not name.endswith(".dist-info") for name in strange):
            raise CheckError(f"it holds {sorted(strange)}")
        check_sources(names)
        check_kernels(archive, [target])
    return target


def check_sdist(path: Path) -> None:
    """A source archive."""
    stem = f"roigs-{engine_version()}"
    if path.name != f"{stem}.tar.gz":
        raise CheckError(f"not {stem}.tar.gz")
    with tarfile.open(path) as archive:
        names = {name.removeprefix(f"{stem}/") for name in archive.getnames()}
    for name in ("pyproject.toml", "setup.py", "LICENSE", "README.md", "CHANGELOG.md"):
        if name not in names:
            raise CheckError(f"missing {name}")
    check_sources(names)
    compiled = [name for name in names if name.startswith(f"{KERNELS}lib/")]
    if compiled:
        raise CheckError(f"it holds compiled kernels: {sorted(compiled)}")


def check_extension(path: Path) -> None:
    """The Blender extension: the kernels of every platform, and nothing for development."""
    if path.name != f"roigs-{engine_version()}.zip":
        raise CheckError(f"not roigs-{engine_version()}.zip")
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        for name in ("blender_manifest.toml", "__init__.py", "roigs_addon/__init__.py"):
            if name not in names:
                raise CheckError(f"missing {name}")
        tops = {name.partition("/")[0] for name in names}
        for_development = {"tests", "benchmarks", "demo", "docs", "Makefile", "setup.py"}
        for_development |= {"CITATION.cff", "CONTRIBUTING.md", "MANIFEST.in"}
        for_development |= {"build", "dist", "runs"}
        strange = {name for name in tops if name.startswith(".")} | (tops & for_development)
        if strange:
            raise CheckError(f"it holds {sorted(strange)}")
        check_sources(names)
        check_kernels(archive, list(load_builder().PLATFORMS))


def check_listing(path: Path) -> None:
    """The listing of the extension's repository names the zip beside it, with its hash."""
    name = f"roigs-{engine_version()}.zip"
    listed = json.loads(path.read_text(encoding="utf-8"))["data"]
    if [item["archive_url"] for item in listed] != [f"./{name}"]:
        raise CheckError(f"it does not offer {name} alone")
    archive = path.with_name(name)
    if not archive.is_file():
        raise CheckError(f"{name} is missing")
    if listed[0]["archive_hash"] != f"sha256:{hashlib.sha256(archive.read_bytes()).hexdigest()}":
        raise CheckError(f"{name} is not the one that it names")


def check_folder(folder: Path, *, complete: bool) -> list[str]:
    """All files of a folder; returns a line for each."""
    kinds: list[str] = []
    lines = []
    for path in sorted(folder.iterdir()):
        try:
            if path.suffix == ".whl":
                kinds.append(check_wheel(path))
            elif path.name.endswith(".tar.gz"):
                check_sdist(path)
                kinds.append("source")
            elif path.suffix == ".zip":
                check_extension(path)
                kinds.append("extension")
            elif path.name == "index.json":
                check_listing(path)
                kinds.append("listing")
            elif path.name == "index.html":
                continue
            else:
                raise CheckError("not a file of a release")
        except CheckError as error:
            raise CheckError(f"{path.name}: {error}") from error
        lines.append(f"{path.name}: {kinds[-1]}, {path.stat().st_size / 1000:.0f} kB")
    if not kinds:
        raise CheckError(f"{folder} is empty")
    wanted = ["extension", "listing", "source", *load_builder().PLATFORMS]
    if complete and sorted(kinds) != sorted(wanted):
        raise CheckError(f"the release is {sorted(kinds)}, but must be {sorted(wanted)}")
    return lines


def release_notes() -> str:
    """This version's part of the changelog."""
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    heading = rf"^## \[{re.escape(engine_version())}\][^\n]*\n"
    match = re.search(rf"{heading}(.*?)(?=^## \[|\Z)", text, flags=re.MULTILINE | re.DOTALL)
    if match is None or not match[1].strip():
        raise CheckError(f"CHANGELOG.md says nothing of {engine_version()}")
    return match[1].strip()


def check_tag(tag: str) -> None:
    """The tag names the version, which is the same everywhere."""
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    version = engine_version()
    if manifest["version"] != version:
        raise CheckError(f"the engine is {version}, the add-on {manifest['version']}")
    if tag != f"v{version}":
        raise CheckError(f"the tag is {tag}, but the version is {version}")
    release_notes()


def main() -> int:
    """Exit status 0, or 1 after one line that says what is wrong."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("dist", nargs="?", type=Path, metavar="DIST", help="folder to check")
    parser.add_argument("--complete", action="store_true", help="DIST is a whole release")
    parser.add_argument("--tag", help="must be the version")
    parser.add_argument("--notes", action="store_true", help="print the notes of this version")
    options = parser.parse_args()
    try:
        if options.tag is not None:
            check_tag(options.tag)
        if options.dist is not None:
            print(*check_folder(options.dist, complete=options.complete), sep="\n")
        if options.notes:
            print(release_notes())
    except CheckError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
