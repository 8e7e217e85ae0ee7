"""Imported by a forked engine before it begins: its pycolmap workers are forked as well."""

from __future__ import annotations

from roigs_engine.reconstruction import child
from tests import warm_engine

child.WORKER = warm_engine.module(child.WORKER[-1])
