"""Runs pytest inside a Blender.

    blender -b --factory-startup --python tests/blender/run.py -- [arguments of pytest]

`ROIGS_PYTEST` names a folder with pytest (pip install --target FOLDER pytest), for Blender's own
Python has none. `tools/blender_tests.py` does all of this. Exit status: pytest's.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def main() -> int:
    """Run the tests that need a Blender, or those that are named."""
    sys.path[:0] = [str(ROOT), *filter(None, [os.environ.get("ROIGS_PYTEST", "")])]
    import pytest

    arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []
    if all(argument.startswith("-") for argument in arguments):
        arguments = ["tests/addon", *arguments]
    os.chdir(ROOT)
    return int(pytest.main(["-p", "no:cacheprovider", *arguments]))


if __name__ == "__main__":
    sys.exit(main())
