"""The compared revisions of the engine and instruction sets, each in its own processes."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent


@dataclass(frozen=True)
class Variant:
    """An engine, and how to run it.

    Attributes:
        name: the engine's git revision, or "this" for this checkout.
        engine: folder with the package `roigs_engine`.
        isa: instruction set; empty: the best.
    """

    name: str
    engine: Path
    isa: str

    def environment(self) -> dict[str, str]:
        """Environment for `roigs_engine` of the variant, and `benchmarks` of this checkout."""
        path = os.pathsep.join([str(self.engine), str(ROOT)])
        found = {**os.environ, "PYTHONPATH": path, "PYTHONSAFEPATH": "1"}
        return {**found, "ROIGS_ISA": self.isa} if self.isa else found


class Worker:
    """A process that runs benchmarks/worker.py."""

    def __init__(self, variant: Variant, job: dict[str, Any]) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.worker", json.dumps(job)],
            env=variant.environment(),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def ask(self, question: str) -> Any:
        """Ask the worker; returns its answer. SystemExit: it has ended, and printed the reason."""
        assert self._process.stdin is not None and self._process.stdout is not None
        with suppress(BrokenPipeError):
            print(question, file=self._process.stdin, flush=True)
        answer = self._process.stdout.readline()
        if not answer:
            raise SystemExit(f"error: the measuring process has ended at {question!r}.")
        return json.loads(answer)

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.communicate()


@contextmanager
def engines(revision: str | None) -> Iterator[dict[str, Path]]:
    """Build kernels, and yield name -> folder: a git revision if one is given, then "this".

    Raises:
        SystemExit: the revision's engine lacks something that the benchmarks use.
    """
    with tempfile.TemporaryDirectory(prefix="roigs-compare-") as folder:
        found = {}
        if revision is not None:
            found[revision] = Path(folder)
            archive = subprocess.run(
                ["git", "archive", revision, "roigs_engine"],
                cwd=ROOT,
                stdout=subprocess.PIPE,
                check=True,
            )
            with tarfile.open(fileobj=io.BytesIO(archive.stdout)) as tar:
                tar.extractall(folder, filter="data")
            if not _has_what_they_use(Path(folder)):
                raise SystemExit(
                    f"error: the engine of {revision} is too old for these benchmarks;"
                    " run the benchmarks of that revision instead."
                )
        found["this"] = ROOT
        for engine in found.values():
            subprocess.run(
                [sys.executable, "-m", "roigs_engine.kernels.build"],
                env=Variant("", engine, "").environment(),
                stdout=subprocess.DEVNULL,
                check=True,
            )
        yield found


def _has_what_they_use(engine: Path) -> bool:
    """Whether the benchmarks of this checkout can be imported with an engine."""
    tried = subprocess.run(
        [sys.executable, "-c", "import benchmarks.worker"],
        env=Variant("", engine, "").environment(),
        stderr=subprocess.DEVNULL,
        check=False,
    )
    return tried.returncode == 0
