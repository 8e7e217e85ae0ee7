"""Progress for people and for logs, and signals."""

from __future__ import annotations

import io
import os
import signal

import pytest

from roigs_addon.jobs.terminal import Terminal, stopping


class Screen(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_terminal_has_one_line_that_changes() -> None:
    screen = Screen()
    line = Terminal(screen)
    line.show("step 10")
    line.show("step 9")
    line.show("step 9")
    line.line("a message")
    line.close()
    assert screen.getvalue() == "\rstep 10\rstep 9 \na message\n"


def test_a_log_has_a_line_now_and_then_and_for_every_topic() -> None:
    log = io.StringIO()
    line = Terminal(log, every=3600)
    for step in range(5):
        line.show(f"scene {step}", topic="scene")
    line.show("joint 0", topic="joint")
    line.line("a message")
    assert log.getvalue() == "scene 0\njoint 0\na message\n"


@pytest.mark.skipif(os.name == "nt", reason="Windows has no signal to send to oneself")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_first_signal_stops_and_the_second_interrupts(number: signal.Signals) -> None:
    before = signal.getsignal(number)
    asked: list[int] = []
    with stopping(lambda: asked.append(1)):
        os.kill(os.getpid(), number)
        assert asked == [1]
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), number)
    assert asked == [1]
    assert signal.getsignal(number) == before
