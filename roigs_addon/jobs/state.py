"""State of a job. No bpy."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from ..shared import events, text

STOPPING = "Stopping …"
STOPPED = "Stopped."
WAITING = "The engine has finished. Its results load after the render."
MOST_WARNINGS = 4  # a panel has no room for more; all are in the log


@dataclass(kw_only=True)
class JobState:
    """The state of a job for the panel. Without any job, the title is empty.

    Attributes:
        title: of the job.
        log: file of the engine's log.
        stage, step, total: progress; `stage` is empty before the first and after the last stage.
        loss, psnr, gaussians: last values from the engine; 0 without one.
        seconds_left, run_seconds_left: remaining time of the stage and of all stages; 0 if unknown.
        message: for the user, replaced by the next one.
        device: the training device, and the reason; empty before the engine reports it.
        warnings: for the user, the first few; they stay after the job.
        error: why the job failed; empty if it did not.
        outcome: result of the job, for the user; empty where the window shows it.
    """

    title: str = ""
    log: Path | None = None
    stage: str = ""
    step: int = 0
    total: int = 0
    loss: float = 0.0
    psnr: float = 0.0
    gaussians: int = 0
    seconds_left: float = 0.0
    run_seconds_left: float = 0.0
    message: str = ""
    error: str = ""
    outcome: str = ""
    device: str = ""
    warnings: list[str] = field(default_factory=list)

    def take(self, event: events.Record) -> None:
        """Update the state with an event of the engine."""
        match event["event"]:
            case "stagestarted":
                self.stage, self.total = event.get("stage", ""), event.get("total", 0)
                self.step = 0
            case "progress":
                self.stage = event.get("stage", "")
                self.step, self.total = event.get("step", 0), event.get("total", 0)
                self.loss, self.psnr = event.get("loss", 0.0), event.get("psnr", 0.0)
                self.gaussians = event.get("gaussians", 0)
                self.seconds_left = event.get("seconds_left", 0.0)
                self.run_seconds_left = event.get("run_seconds_left", 0.0)
            case "device":
                self.device = events.device_in_words(event)
            case "message":
                self._hear(event.get("text", ""), event.get("level", ""))

    def _hear(self, text: str, level: str) -> None:
        if level != "warning":
            self.message = self.message if level == "detail" else text
        elif text not in self.warnings and len(self.warnings) < MOST_WARNINGS:
            self.warnings.append(text)

    def in_words(self) -> str:
        """Return the progress of the job in one line."""
        if not self.stage:
            return self.title
        share = f" {self.step:,} / {self.total:,}" if self.total else ""
        quality = f", {self.psnr:.1f} dB" if self.psnr else ""
        size = f", {self.gaussians:,} Gaussians" if self.gaussians else ""
        left = self.time_left()
        return f"{self.stage}{share}{quality}{size}{left and f', {left}'}"

    def time_left(self) -> str:
        """Return 'about 2 minutes left', for all stages or for this one; empty if unknown."""
        if self.run_seconds_left > 0:
            return f"about {text.duration(self.run_seconds_left)} left"
        left = self.seconds_left
        return f"about {text.duration(left)} left in this part" if left > 0 else ""
