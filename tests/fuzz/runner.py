"""Runs many cases on a few worker processes.

`python -m tests.fuzz.runner [SHARE [FAMILY ...]]` prints a table.

A worker that dies (a crash, a hang, memory beyond bounds inside a library) is replaced by one that
goes on behind the case it died of.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from tests.fuzz.cases import all_families

ROOT = Path(__file__).resolve().parents[2]
CHUNK = 300  # cases of one worker: a share of the work, and a bound to what may pile up in it
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "2"}


@dataclass
class Result:
    """The results of cases.

    Attributes:
        ended: (family, exit status) -> how many.
        wrong: case -> what was wrong with its end.
        peak_mib: the largest resident memory of a worker, its packages included.
    """

    ended: Counter[tuple[str, str]] = field(default_factory=Counter)
    wrong: dict[str, str] = field(default_factory=dict)
    peak_mib: float = 0.0

    @property
    def cases(self) -> int:
        """Number of cases that ran."""
        return self.ended.total() + len(self.wrong)


def work(
    cases: Sequence[str],
    result: Result,
    command: Sequence[str] = (sys.executable, "-m", "tests.fuzz.worker"),
) -> None:
    """Run the cases ('family number') one after another, into `result`; `command` is a worker."""
    while cases:
        done = subprocess.run(
            command,
            cwd=ROOT,
            env=os.environ | ONE_THREAD | {"PYTHONPATH": str(ROOT)},
            input="\n".join(cases),
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
        )
        records = [json.loads(line) for line in done.stdout.splitlines()]
        for record in records:
            result.peak_mib = max(result.peak_mib, record["peak_mib"])
            if record["ended"] in ("0", "2"):
                result.ended[record["case"].split()[0], record["ended"]] += 1
            else:
                result.wrong[record["case"]] = record["ended"]
        cases = cases[len(records) :]
        if cases:
            what = f"the process ended ({done.returncode})\n{done.stderr[-3000:]}"
            result.wrong[cases[0]] = what
            cases = cases[1:]


def sample(share: float, families: Sequence[str] = ()) -> list[str]:
    """The first cases of these families (none: of all), that share of them and one at least."""
    return [
        f"{family} {number}"
        for family, (_, most) in all_families().items()
        if not families or family in families
        for number in range(max(1, round(most * share)))
    ]


def run(share: float, families: Sequence[str] = (), workers: int = 2) -> Result:
    """Run that share of the cases on so many processes."""
    result, cases = Result(), sample(share, families)
    with ThreadPoolExecutor(workers) as pool:
        jobs = [
            pool.submit(work, cases[first : first + CHUNK], result)
            for first in range(0, len(cases), CHUNK)
        ]
        for job in jobs:
            job.result()
    return result


def main(share: float, families: Sequence[str]) -> None:
    """Print what went wrong, and a table."""
    started = time.monotonic()
    result = run(share, families)
    for case, what in result.wrong.items():
        print(f"--- {case}\n{what}")
    for family in families or all_families():
        well, refused = (result.ended[family, status] for status in "02")
        print(f"{family:13}{well:5} well, {refused:5} refused")
    seconds = time.monotonic() - started
    print(
        f"{result.cases} cases in {seconds:.0f} s, {len(result.wrong)} wrong,"
        f" {result.peak_mib:.0f} MiB"
    )


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 1.0, sys.argv[2:])
