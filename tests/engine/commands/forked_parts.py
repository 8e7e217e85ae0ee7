"""Imported by a forked batch, so that its engines are forked, too."""

from __future__ import annotations

from tests.engine.commands import forked_engines

forked_engines.engine_process.subprocess = forked_engines.FORKED  # type: ignore[attr-defined]
