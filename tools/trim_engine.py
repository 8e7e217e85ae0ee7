"""Removes from this Python's environment what the engine never uses.

    python tools/trim_engine.py

These are files for tests and for compiling against torch. Packages stay whole otherwise: importing
torch and scikit-learn takes parts of every package that they bring. Run it with the Python of an
environment that was made for the engine; it refuses any other.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import sysconfig
from collections.abc import Iterator
from pathlib import Path

# Below the folder of packages. torch needs the rest of its `bin` to start.
TESTS = (
    "torch/test",
    "torch/bin/test_*",
    "torch/bin/*Test",
    "networkx/**/tests",
    "scipy/**/tests",
    "sklearn/**/tests",
    "sympy/**/tests",
)
HEADERS = (
    "torch/include",
    "torch/share/cmake",
    "torch/bin/protoc*",
    "torch/lib/*.lib",  # for Windows' linker
)


def unneeded(packages: Path, patterns: tuple[str, ...]) -> Iterator[Path]:
    """Yield files and folders that match a pattern, without links."""
    for pattern in patterns:
        found = sorted(packages.glob(pattern))
        yield from (path for path in found if path.exists() and not path.is_symlink())


def size(path: Path) -> int:
    """Bytes of a file, or of all files in a folder."""
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(file.lstat().st_size for file in files if not file.is_dir())


def trim(packages: Path) -> int:
    """Remove unneeded files; returns the number of bytes. Files that cannot be removed stay."""
    removed = 0
    for path in unneeded(packages, TESTS + HEADERS):
        before = size(path)
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
        removed += before - (size(path) if path.exists() else 0)
    return removed


def main() -> int:
    """Trim this environment; returns the exit status."""
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0]).parse_args()
    if sys.prefix == sys.base_prefix:
        print("error: This Python is not an environment of its own.", file=sys.stderr)
        return 2
    removed = trim(Path(sysconfig.get_path("purelib")))
    print(f"Removed {removed / 1e6:.0f} MB that the engine does not use.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
