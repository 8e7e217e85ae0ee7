"""Settings of the whole test suite."""

from __future__ import annotations

import os
import sys
from importlib import metadata
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

# Where cores are shared, threads wait for each other longer than small arrays take. This is what
# torch and BLAS would use unasked; the kernels' threads are the engine's `--threads`.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
# A new environment would compile gsply's functions for a minute, in each process. With numpy 2 they
# have to: as plain Python, their small integers overflow.
if metadata.version("numpy").startswith("1."):
    os.environ.setdefault("NUMBA_DISABLE_JIT", "1")

# In a checkout whose folder is named 'tests', that name is the top folder's, to pytest.
if "tests.tests" in sys.modules:
    sys.modules["tests"] = sys.modules["tests.tests"]


# Files that take longest, so that none is left for the end, when other processes have no work.
LONGEST = (
    *("test_ray.py", "test_batch.py", "test_links.py", "test_formats.py", "test_killed.py"),
    *("test_training.py", "test_store.py", "test_full_disk.py", "test_damaged_input.py"),
    *("test_limits.py", "test_events_and_stop.py", "test_import.py", "test_awkward_photos.py"),
    *("test_safety.py", "test_drawing.py", "test_streamed_sog.py", "test_deaths.py"),
    *("test_reconstructing.py", "test_killed_levels.py", "test_scratch.py"),
)


class RootIsNoPackage:
    """The project's top folder is a package for Blender (its `__init__.py`), but not for pytest.

    Without this, pytest would import that file, and with it the add-on, before every test.
    """

    @pytest.hookimpl(tryfirst=True)
    def pytest_collect_directory(
        self, path: Path, parent: pytest.Collector
    ) -> pytest.Collector | None:
        """An ordinary folder for the top folder; for others pytest decides."""
        return pytest.Dir.from_parent(parent, path=path) if path == ROOT else None


def same_examples() -> None:
    """Have hypothesis draw the same examples in each run, with no time limit on one.

    Unasked, it also draws constants of whatever modules of the project are imported. So what a
    test got depended on the tests before it, and on any line that changed anywhere.
    """
    try:
        import hypothesis
        from hypothesis.internal.conjecture import providers
    except ImportError:  # tests/engine and tests/fuzz also run where it is not installed
        return
    hypothesis.settings.register_profile(
        "roigs", derandomize=True, deadline=None, database=None, max_examples=50
    )
    hypothesis.settings.load_profile("roigs")
    providers._get_local_constants = lambda: providers._local_constants


def pytest_configure(config: pytest.Config) -> None:
    """Register what must be known before collection begins."""
    config.pluginmanager.register(RootIsNoPackage())
    same_examples()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest files first; else the order stays."""
    ranks = {name: rank for rank, name in enumerate(LONGEST)}
    items.sort(key=lambda item: ranks.get(item.path.name, len(LONGEST)))


@pytest.hookimpl(optionalhook=True)
@pytest.hookimpl(optionalhook=True)  # a Blender's Python has no xdist
def pytest_xdist_auto_num_workers() -> int:
    """One process more than there are cores: a third of the time, tests wait for another one."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return (cores or 1) + 1
