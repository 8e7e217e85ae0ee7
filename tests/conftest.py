"""Settings of the whole test suite."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


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


def pytest_configure(config: pytest.Config) -> None:
    """Register what must be known before collection begins."""
    config.pluginmanager.register(RootIsNoPackage())
