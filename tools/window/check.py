"""Clicks through the add-on in a real Blender window, and measures how it answers.

    python -m tools.window.check BLENDER --engine-python PYTHON

Needs what `driver` needs. Prints one line per check; the exit status is 1 when one failed.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
from pathlib import Path

from .driver import Blender, Screen, with_extension
from .scenario import (
    BUSY,
    JOB,
    STATE,
    import_demo,
    load_boxes,
    open_photos_panel,
    parser,
    prepare,
    show_tab,
)

failures: list[str] = []


def check(text: str, good: bool) -> None:
    """Print the result of a check; a bad one is also added to `failures`."""
    print(f"{'good' if good else 'BAD '} {text}", flush=True)
    if not good:
        failures.append(text)


def alive(pid: int) -> bool:
    """Whether a process is running, and not a zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def gone_after(pid: int, start: float, limit: float = 20.0) -> float:
    """Seconds from `start` until the process is gone."""
    while alive(pid) and time.time() - start < limit:
        time.sleep(0.02)
    return time.time() - start


def stopped(blender: Blender, pid: int, what: str, since: float) -> None:
    """Check how long the engine took to end."""
    heard = blender.until(f"{JOB}.stopping or {JOB}.finished", 20)
    took = gone_after(pid, since)
    check(
        f"{what}: noticed by Blender within {heard:.2f} s, engine ended after {took:.2f} s (2 s);"
        f" load of the machine {os.getloadavg()[0]:.0f}",
        took <= 2.0,
    )


def settings(blender: Blender, run: Path, steps: float) -> None:
    """Set small photos and few steps."""
    blender.ask(
        f"s = bpy.context.scene.roigs; s.run_dir = {str(run)!r}; s.max_side = 160;"
        f" s.steps_factor = {steps}"
    )


def handled(blender: Blender, event: str, place: tuple[int, int]) -> tuple[float, float]:
    """Click; returns seconds until Blender noted the effect: wall clock, and its processor time.

    On a busy machine, only the second number is meaningful.
    """
    before = blender.ask("time.process_time()")
    since = blender.click(place)
    blender.until(f"any(text == {event!r} and at > {since} for at, _, text in events)", 20)
    at, processor = next(
        (at, processor)
        for at, processor, text in blender.ask("events")
        if text == event and at > since
    )
    return float(at - since), float(processor - before)


WATCH = """
camera, drawn = [None], [0]
def count(panel, context):
    drawn[0] += 1
bpy.types.ROIGS_PT_train.append(count)
def watch(scene, graph=None):
    name = scene.camera.name if scene.camera else None
    if name != camera[0]:
        camera[0] = name
        note("camera")
bpy.app.handlers.depsgraph_update_post.append(watch)
"""


def start_training(blender: Blender) -> int:
    """Click Train or Continue; returns the engine's process."""
    blender.click(blender.find("roigs.train_roi", x=0.3))
    blender.until(f"{BUSY} and {STATE}.step > 0", 120)
    return int(blender.ask(f"{JOB}.process.pid"))


def first_window(blender: Blender, folder: Path) -> None:
    """Import, select and train; check response times, Esc, stop, continue, a killed engine."""
    prepare(blender)
    import_demo(blender)
    load_boxes(blender)
    run = folder / "run"
    settings(blender, run, 1.0)
    blender.ask(WATCH)
    blend = folder / "demo.blend"
    blender.ask(f"bpy.ops.wm.save_as_mainfile(filepath={str(blend)!r})")

    open_photos_panel(blender, "roigs.select_cameras", 0.5)
    at = blender.find("roigs.select_cameras")
    start = blender.click(at)
    blender.until("all(len(o.roigs.selection) for o in bpy.data.objects if o.roigs.kind == 'ROI')")
    check(f"Select Cameras clicked: selected after {time.time() - start:.1f} s", True)

    pid = start_training(blender)
    engine = os.readlink(f"/proc/{pid}/exe")
    check(f"Train clicked: the engine runs as process {pid}, {engine}", True)
    answers = []
    for _ in range(8):
        next_photo = blender.find("step=1", x=0.84)
        answers.append(handled(blender, "camera", next_photo))
        time.sleep(0.7)
    clock, processor = (sorted(column) for column in zip(*answers, strict=True))
    check(
        f"clicks while it trains: median {clock[4]:.2f} s, slowest {clock[-1]:.2f} s (1 s);"
        f" of Blender's processor time {processor[4]:.2f} s, {processor[-1]:.2f} s;"
        f" load of the machine {os.getloadavg()[0]:.0f} on {os.cpu_count()} cores",
        clock[-1] <= 1.0,
    )
    blender.screen.do("mousemove", "600", "500")
    where = f"[{STATE}.stage, {STATE}.step]"
    step, drawn = blender.ask(where), blender.ask("drawn[0]")
    time.sleep(3)
    now, then = blender.ask(where), blender.ask("drawn[0]")
    check(f"mouse at rest for 3 s: {step} to {now}, {then - drawn} drawings", now != step)
    check("the bar is drawn meanwhile", then - drawn >= 4)
    preview = (
        "[o for o in bpy.data.objects if o.roigs.level == 'PREVIEW' and o.roigs.kind == 'SPLATS']"
    )
    check(
        f"preview after {blender.until(f'bool({preview})', 60):.0f} s more: "
        f"{blender.ask(f'{preview}[0].roigs.ply')}",
        True,
    )
    blender.screen.picture(folder / "training.png")

    blender.ask("call('roigs.select_roi', name='vase')")
    blender.screen.do("mousemove", "500", "450")
    time.sleep(0.2)
    blender.press("g")
    blender.screen.do("mousemove", "560", "420")
    time.sleep(0.5)
    blender.press("Escape")
    time.sleep(1.0)
    check("Esc ends a transform only", bool(blender.ask(f"{BUSY} and not {JOB}.stopping")))

    stopped(blender, pid, "Esc", blender.press("Escape"))
    left = list(run.glob("stages/*/checkpoint.bin"))
    check(f"a checkpoint is kept: {[p.parent.name for p in left]}", bool(left))
    blender.until(f"not {BUSY}")
    time.sleep(0.5)
    blender.screen.picture(folder / "stopped.png")

    step = blender.ask(f"{STATE}.step")
    pid = start_training(blender)
    now = blender.ask(f"{STATE}.step")
    check(f"Continue resumes: step {now}, stopped at {step}", now >= step)
    stopped(blender, pid, "Stop clicked", blender.click(blender.find("roigs.stop", x=0.84)))
    blender.until(f"not {BUSY}")

    pid = start_training(blender)
    os.kill(pid, signal.SIGKILL)
    blender.until(f"not {BUSY}")
    error = blender.ask(f"{STATE}.error")
    check(f"engine killed: '{error}'", bool(error) and blender.process.poll() is None)
    time.sleep(0.5)
    blender.screen.picture(folder / "killed.png")
    blender.screen.do("mousemove", "400", "300")  # the report disappears when the mouse leaves it
    time.sleep(0.5)

    pid = start_training(blender)
    blender.ask("bpy.ops.wm.save_mainfile()")
    start = time.time()
    blender.kill()
    took = gone_after(pid, start)
    check(f"Blender killed: the engine ended after {took:.2f} s (5 s)", took <= 5.0)


def second_window(blender: Blender, folder: Path) -> None:
    """Open the file again."""
    show_tab(blender)
    place = blender.find("roigs.train_roi", x=0.3)
    time.sleep(0.5)
    blender.screen.picture(folder / "reopened.png")
    left = [p.parent.name for p in (folder / "run").glob("stages/*/checkpoint.bin")]
    check(f"opened again: the run is at {left}", bool(left))
    blender.ask("bpy.context.scene.roigs.steps_factor")
    blender.click(place)
    blender.until(f"{BUSY} and {STATE}.step > 0", 120)
    check(f"Continue resumes at step {blender.ask(f'{STATE}.step')}", True)
    blender.press("Escape")
    blender.until(f"not {BUSY}")


def main() -> int:
    """Run all checks."""
    options = parser(__doc__)
    options.add_argument("--keep", type=Path, help="folder for the pictures and logs")
    given = options.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        resources = with_extension(given.blender, folder)
        screen = Screen(1400, 1150)
        python = {"ROIGS_ENGINE_PYTHON": str(given.engine_python)}
        try:
            for work, more in ((first_window, ()), (second_window, (str(folder / "demo.blend"),))):
                with Blender(
                    given.blender,
                    screen,
                    resources,
                    log=folder / "blender.log",
                    arguments=more,
                    variables=python,
                ) as blender:
                    try:
                        work(blender, folder)
                    except Exception:
                        screen.picture(folder / "failed.png")
                        raise
        finally:
            screen.close()
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
