"""A batch on Ray against the same parts by hand: time, overhead, bytes.

    python -m benchmarks.cluster --out DIR [--scenes 4] [--steps-factor 0.1]

The scenes are the demo with its boxes, each with another seed. Three ways do the same parts: by
hand, one engine process after the other; `batch --cluster` on a Ray of one node of one core; and on
two. All are on this machine, so it needs two idle cores; the load average stands beside the times.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks.markdown import table
from roigs_engine.app.batch_plan import plan_row
from roigs_engine.app.batch_table import Table
from roigs_engine.batch.engine_process import DONE
from roigs_engine.batch.record import BatchRecord
from roigs_engine.batch.staged import run_part
from roigs_engine.context import QUIET
from roigs_engine.formats.files import write_json

DEMO = Path(__file__).resolve().parents[1] / "demo" / "scene"
STORE = 80 << 20  # bytes of Ray's object store
HEAD = ("how", "seconds", "over by hand", "speed", "load", "same bytes")


def by_hand(path: Path, folder: Path) -> None:
    """Run the parts of a table one after the other, each on one core."""
    for row in Table(path, folder).rows:
        write_json(row.options_file, row.options)
        scene = plan_row(row, BatchRecord(folder), QUIET).scene
        for part in scene.parts:
            ended = run_part(part, 1, lambda event: None, lambda: False)
            if ended.state != DONE:
                sys.exit(f"{part.label}: {ended.reason}")


def on_cluster(path: Path, folder: Path, address: str) -> None:
    """Run a table on a cluster."""
    command = [sys.executable, "-m", "roigs_engine", "batch", str(path), "--run-dir", str(folder)]
    subprocess.run([*command, "--cluster", address], check=True, stdout=subprocess.DEVNULL)


@contextmanager
def cluster(nodes: int) -> Iterator[str]:
    """Start Ray with `nodes` nodes of one core, on loopback; yields its address."""
    os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"
    from ray.cluster_utils import Cluster

    each: dict[str, Any] = {"num_cpus": 1, "object_store_memory": STORE}
    head = {**each, "include_dashboard": False, "node_ip_address": "127.0.0.1"}
    made: Any = Cluster(initialize_head=True, head_node_args=head)
    try:
        for _ in range(nodes - 1):
            made.add_node(**each)
        yield made.address
    finally:
        for node in [*made.worker_nodes, made.head_node]:
            made.remove_node(node, allow_graceful=False)  # ending it gracefully timed out
        made.shutdown()


def write_table(path: Path, scenes: int, factor: float) -> None:
    """Write the table, which trains the demo several times."""
    lines = [
        *("[defaults]", f"scene = '{DEMO}'", f"rois = '{DEMO / 'rois.json'}'", "device = 'cpu'"),
        *("max_side = 320", f"steps_factor = {factor}"),
    ]
    lines += [f"[scenes.hall-{seed}]\nseed = {seed}" for seed in range(scenes)]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines), encoding="utf-8")


def models(folder: Path) -> dict[str, str]:
    """PLY -> its hash."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*.ply"))
    }


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--scenes", type=int, default=4)
    parser.add_argument("--steps-factor", type=float, default=0.1)
    args = parser.parse_args()
    out = args.out.absolute()
    path = out / "museum.toml"
    write_table(path, args.scenes, args.steps_factor)
    seconds: dict[str, float] = {}
    load: dict[str, float] = {}
    for how, nodes in (("by hand", 0), ("one node", 1), ("two nodes", 2)):
        folder = out / how.replace(" ", "-")
        if nodes:
            with cluster(nodes) as address:
                began = time.perf_counter()
                on_cluster(path, folder, address)
                seconds[how] = time.perf_counter() - began
        else:
            began = time.perf_counter()
            by_hand(path, folder)
            seconds[how] = time.perf_counter() - began
        load[how] = os.getloadavg()[0]
        print(f"{how}: {seconds[how]:.0f} s", file=sys.stderr)
    whole = models(out / "by-hand")
    rows = [
        (
            how,
            f"{took:.0f}",
            f"{100 * (took / seconds['by hand'] - 1):+.0f} %",
            f"{seconds['one node'] / took:.2f} x",
            f"{load[how]:.1f}",
            "yes" if models(out / how.replace(" ", "-")) == whole else "NO",
        )
        for how, took in seconds.items()
    ]
    print("\n".join(table(HEAD, rows, names=1)))


if __name__ == "__main__":
    main()
