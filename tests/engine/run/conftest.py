"""Whole runs of little work."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from roigs_engine.training import floaters


@pytest.fixture(scope="module", autouse=True)
def few_views_between_photos() -> Iterator[None]:
    """Floaters are sought in few views: in tiny runs, that takes longer than all steps."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(floaters, "MOST_VIEWS", 6)
        yield
