"""Fixtures of the tests of exchange formats."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from roigs_engine.exchange import usd


@pytest.fixture(autouse=True)
def opened_at_once(request: pytest.FixtureRequest) -> Iterator[None]:
    """Whole files of OpenUSD are opened without a process that looks first, a quarter second each.

    Not so in tests marked `cold`, whose files are damaged.
    """
    with pytest.MonkeyPatch.context() as patch:
        if request.node.get_closest_marker("cold") is None:
            patch.setattr(usd, "_refuse_crash", lambda _: None)
        yield
