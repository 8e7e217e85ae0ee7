"""Runs parts as Ray tasks on the machines of a cluster."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from .. import __version__
from ..context import Context
from ..errors import ConfigError
from ..formats.text import counted, first_line
from . import ray_tasks
from .engine_process import LOST, Outcome
from .local import Report
from .parts import Part
from .ray_connection import CONNECT_SECONDS, POLL, Connection

LOOK_SECONDS = 120.0  # for a machine to answer; it must import the engine first
NODE_LABEL = "ray.io/node-id"  # Ray's label of each machine
REFRESH = 5.0  # seconds between two checks of the machines


class RayExecutor:
    """Starts parts on Ray.

    Args:
        address: `local`, `auto`, `HOST:PORT` or `ray://HOST:PORT`.
        sign: a file of the batch that every machine must see; None: the batch is on a store.
        context: asked whether to stop; receives warnings.

    Raises:
        ConfigError: Ray is not installed, there is no cluster, or none of its machines fits.
    """

    def __init__(self, address: str, sign: Path | None, context: Context) -> None:
        self._sign, self._context = str(sign or ""), context
        self._connection = Connection(address)
        self._ray = self._connection.ray
        self._running: dict[Any, tuple[Part, float]] = {}  # reference -> part, its cores
        self._misfits: set[str] = set()
        self._silent: dict[str, float] = {}  # node -> time since which it has not answered
        self._looks: dict[str, Any] = {}  # node -> reference of a running check
        self._said: set[tuple[str, str]] = set()  # nodes' problems already reported
        self._fitted = time.monotonic()  # last time at which a machine fitted
        self._stopped: set[tuple[str, str]] = set()  # parts that were asked to stop
        self._looked = 0.0
        self._nodes: dict[str, dict[str, float]] = {}  # machines that fit: id -> resources
        try:
            self._do = self._ray.remote(max_retries=0)(ray_tasks.do_part)
            self._look = self._ray.remote(num_cpus=0, max_retries=0)(ray_tasks.look)
            while not self._nodes:
                context.check_cancelled()
                self._connection.ask(lambda: self._refresh(REFRESH))
                time.sleep(0.0 if self._nodes else POLL)
            self._mailbox = self._connection.ask(self._new_mailbox)
        except BaseException:
            self.close()
            raise

    def has_capacity(self, part: Part, avoid: tuple[str, ...] = ()) -> bool:
        """Whether a core is free; see `LocalExecutor.has_capacity`."""
        taken = sum(cores for _, cores in self._running.values())
        return taken + 1 <= sum(has.get("CPU", 0.0) for has in self._fit(avoid).values())

    def _fit(self, avoid: tuple[str, ...]) -> dict[str, dict[str, float]]:
        """The machines except those to avoid; all if there are no others."""
        return {n: has for n, has in self._nodes.items() if n not in avoid} or self._nodes

    def start(self, part: Part, waiting: int, avoid: tuple[str, ...] = ()) -> int:
        """Give a part to Ray; see `LocalExecutor.start`."""
        return self._connection.ask(lambda: self._start(part, waiting, avoid))

    def _start(self, part: Part, waiting: int, avoid: tuple[str, ...]) -> int:
        fit = self._fit(avoid)
        others = (self._nodes.keys() - fit.keys()) | self._misfits
        wanted = demand(part, list(fit.values()), len(self._running) + 1 + waiting)
        cores = int(wanted["num_cpus"])
        task = self._do.options(
            **wanted,
            scheduling_strategy="SPREAD",
            label_selector={NODE_LABEL: f"!in({', '.join(sorted(others))})"} if others else {},
        )
        reference = task.remote(part, cores, self._mailbox, __version__, self._sign)
        self._running[reference] = (part, cores)
        return cores

    def wait(self, seconds: float) -> list[Report]:
        """Reports since the last call (see `LocalExecutor`). EngineError: the cluster is gone."""
        return self._connection.ask(lambda: self._wait(seconds))

    def _wait(self, seconds: float) -> list[Report]:
        ended: list[Any] = []
        if self._running:
            ended, _ = self._ray.wait(list(self._running), timeout=seconds)
        else:  # no machine has resources left
            time.sleep(seconds)
        if time.monotonic() - self._looked > REFRESH:
            self._refresh()
        by_key = {part.key: part for part, _ in self._running.values()}
        reports: list[Report] = [
            (by_key[key], event) for key, event in self._post() if key in by_key
        ]
        for reference in ended:
            part, _ = self._running.pop(reference)
            self._stopped.discard(part.key)
            reports.append((part, self._outcome(reference)))
        return reports

    def can_move(self, avoid: tuple[str, ...]) -> bool:
        """Whether there is a machine where the part has not failed."""
        return bool(self._nodes.keys() - set(avoid))

    def stop(self, part: Part) -> None:
        """Ask one part to stop, with a checkpoint."""
        self._stopped.add(part.key)

    def close(self) -> None:
        """Leave the cluster; one started for the batch ends."""
        self._connection.close()

    def _post(self) -> list[Any]:
        """Take new events; none while the mailbox restarts elsewhere."""
        try:
            found = self._mailbox.take.remote(self._context.should_stop(), self._stopped)
            return list(self._ray.get(found, timeout=CONNECT_SECONDS))
        except self._ray.exceptions.RayActorError:
            self._mailbox = self._new_mailbox()
        except self._ray.exceptions.RayError:
            pass
        return []

    def _new_mailbox(self) -> Any:
        """Create a mailbox, on this machine if it belongs to the cluster."""
        home = self._affinity(self._ray.get_runtime_context().get_node_id(), soft=True)
        box = self._ray.remote(ray_tasks.Mailbox)
        return box.options(num_cpus=0, max_restarts=-1, scheduling_strategy=home).remote()

    def _outcome(self, reference: Any) -> Outcome:
        try:
            found = self._ray.get(reference)
        except self._ray.exceptions.RayError as error:
            reason = f"Its machine or process was lost ({first_line(error):.100})."
            return Outcome(state=LOST, reason=reason)
        assert isinstance(found, Outcome)
        return found

    def _affinity(self, node: str, *, soft: bool) -> Any:
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        return NodeAffinitySchedulingStrategy(node_id=node, soft=soft)

    def _refresh(self, patience: float = 0.0) -> None:
        """Check new machines, for `patience` seconds; forget machines that are gone.

        ConfigError: no machine fits.
        """
        self._looked = time.monotonic()
        # A head often provides no cores, so parts cannot run there.
        nodes = (n for n in self._ray.nodes() if n["Alive"])
        alive = {n["NodeID"]: n for n in nodes if n["Resources"].get("CPU", 0.0) >= 1}
        if not alive:
            self._say("", "No machine of the Ray cluster has a free core; waiting for one.")
        self._take_looks(alive, patience)
        self._nodes = {node: alive[node]["Resources"] for node in self._nodes if node in alive}
        if self._nodes or self._running:
            self._fitted = time.monotonic()
        elif (alive and alive.keys() <= self._misfits) or (
            time.monotonic() - self._fitted > LOOK_SECONDS
        ):
            raise ConfigError(
                f"No machine of the Ray cluster {self._connection.address} can be used"
                f" ({counted(len(alive), 'machine')} there).",
                "The warnings above say why.",
            )

    def _take_looks(self, alive: Mapping[str, Any], patience: float) -> None:
        """Send checks to new machines, and evaluate the answers.

        A machine that does not answer is checked again, because its memory may be full for a while.
        If this continues, there is a warning.
        """
        self._looks = {node: found for node, found in self._looks.items() if node in alive}
        for node in alive.keys() - self._nodes.keys() - self._misfits - self._looks.keys():
            there = self._affinity(node, soft=False)
            self._looks[node] = self._look.options(scheduling_strategy=there).remote(self._sign)
        waiting = list(self._looks.values())
        if waiting and patience:
            self._ray.wait(waiting, timeout=patience)
        elif patience:
            time.sleep(POLL)
        ready: list[Any] = []
        if waiting:
            rest = min(patience, REFRESH)
            ready, _ = self._ray.wait(waiting, num_returns=len(waiting), timeout=rest)
        for node, reference in [pair for pair in self._looks.items() if pair[1] in ready]:
            del self._looks[node]
            problem, may_pass = self._problem(reference)
            if not problem:
                self._nodes[node] = {}
                self._silent.pop(node, None)
                continue
            if not may_pass:
                self._misfits.add(node)
            elif time.monotonic() - self._silent.setdefault(node, time.monotonic()) < REFRESH:
                # For a while, Ray refuses tasks for a machine that has just joined.
                continue
            where = alive[node]["NodeManagerAddress"]
            self._say(node, f"Machine {where} is not used: it {problem}.")

    def _say(self, node: str, problem: str) -> None:
        """Warn of a node's problem, once."""
        if (node, problem) not in self._said:
            self._said.add((node, problem))
            self._context.warn(problem)

    def _problem(self, reference: Any) -> tuple[str, bool]:
        """Why a machine cannot be used (empty if it can), and whether this may be temporary."""
        try:
            found = self._ray.get(reference)
        except self._ray.exceptions.RayError as error:
            if "No module named" in str(error):
                return "has no roigs; install it there (pip install 'roigs[cluster]')", False
            return f"does not answer ({type(error).__name__})", True
        return ray_tasks.misfit(found, __version__, self._sign), False


def demand(part: Part, nodes: Sequence[Mapping[str, float]], parts: int) -> dict[str, int]:
    """The resources to request from Ray for a part; at least one machine has all of them.

    Args:
        nodes: resources of the machines that may run it.
        parts: number of parts that share the cores, this one included.
    """
    gpu = part.gpu and any(node.get("GPU") for node in nodes)
    nodes = [node for node in nodes if node.get("GPU") or not gpu]
    memory = int(min(part.memory, max(node.get("memory", 0.0) for node in nodes)))
    has = [int(node["CPU"]) for node in nodes if node.get("memory", 0.0) >= memory]
    # With an even share, parts would wait for large machines while small ones are idle.
    cores = next((c for c in range(max(has), 1, -1) if sum(n // c for n in has) >= parts), 1)
    return {"num_cpus": cores, "num_gpus": int(gpu), "memory": memory}
