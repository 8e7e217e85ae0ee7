"""Real Rays of nodes of one core each, all on loopback."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

EACH = {"num_cpus": 1, "object_store_memory": 80 << 20}
ENVIRONMENT = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0", "RAY_USAGE_STATS_ENABLED": "0"}


@contextmanager
def a_cluster(**head: Any) -> Iterator[Any]:
    """A Ray of two nodes; `second` is the one that is not its head."""
    before = {name: os.environ.get(name) for name in ENVIRONMENT}
    os.environ.update(ENVIRONMENT)  # Ray reads them as it is imported
    pytest.importorskip("ray", reason="Ray is not installed (the extra `cluster`)")
    from ray.cluster_utils import Cluster

    place = tempfile.mkdtemp(prefix="roigs-ray-")  # short: sockets are in it
    settings = {**EACH, "include_dashboard": False, "node_ip_address": "127.0.0.1", **head}
    made = Cluster(initialize_head=True, head_node_args={**settings, "temp_dir": place})
    try:
        made.second = made.add_node(**EACH)
        yield made
    finally:
        made.shutdown()
        shutil.rmtree(place, ignore_errors=True)
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def engines(run: Path) -> list[int]:
    """The processes that do parts of a batch."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = entry.read_bytes().split(b"\0")
        except OSError:
            continue
        if b"--part" in words and any(word.startswith(bytes(run)) for word in words):
            found.append(int(entry.parent.name))
    return found
