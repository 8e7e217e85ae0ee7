"""Real Rays of nodes of one core each, all on loopback."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

EACH = {"num_cpus": 1, "object_store_memory": 80 << 20}
ENVIRONMENT = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0", "RAY_USAGE_STATS_ENABLED": "0"}


@contextmanager
def a_cluster(*, second: bool = True, **head: Any) -> Iterator[Any]:
    """A Ray of two nodes; `second` is the one that is not its head, and may be left out."""
    place = tempfile.mkdtemp(prefix="roigs-ray-")  # short: sockets are in it
    (Path(place) / "ray").mkdir()
    wanted = {**ENVIRONMENT, "RAY_TMPDIR": place}
    with pytest.MonkeyPatch.context() as patch:
        for name, value in wanted.items():  # Ray reads some of them as it is imported
            patch.setenv(name, value)
        try:
            pytest.importorskip("ray", reason="Ray is not installed (the extra `cluster`)")
            from ray.cluster_utils import Cluster

            settings = {**EACH, "include_dashboard": False, "node_ip_address": "127.0.0.1"}
            made = Cluster(initialize_head=True, head_node_args={**settings, **head})
            try:
                made.second = made.add_node(**EACH) if second else None
                yield made
            finally:
                made.shutdown()
        finally:
            _remove(Path(place))


def _remove(folder: Path) -> None:
    """Remove Ray's folder; a process that was killed may write into it once more."""
    for _ in range(50):
        shutil.rmtree(folder, ignore_errors=True)
        if not folder.exists():
            return
        time.sleep(0.1)


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
