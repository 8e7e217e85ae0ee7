"""The model of a step on more cores, from tables as the benchmark of the step prints them."""

from __future__ import annotations

import pytest

from benchmarks import bandwidth, cores_model, tables
from benchmarks.cores_model import CHIPS, makespan, modelled, read_steps
from benchmarks.results import STAGES, Measurement, Row
from benchmarks.synthetic import synthetic_gaussians
from benchmarks.traffic import PARAMETERS, View, stage_bytes

COUNTS = {"visible": [30_000], "intersections": [90_000]}


def measured(threads: int, wall: float, cpu: float, rest: float = 0.0) -> Measurement:
    """Every stage of the kernels takes as long."""
    stages = dict.fromkeys(STAGES, (wall, cpu))
    stages |= {"rest": (rest, rest)}
    row = Row(50_000, 480, 320, threads)
    return Measurement(row, "this", "avx512", COUNTS, rounds=[[stages]], peak=1.0)


def printed(*measurements: Measurement) -> str:
    return f"{tables.stage_table(measurements)}\n\n{tables.work_table(measurements)}\n"


def test_tables_are_read() -> None:
    text = printed(measured(1, 8.0, 8.0, 0.5), measured(2, 5.0, 8.0, 0.5))
    (step,) = read_steps(f"before\n\n{text}\nafter")
    assert (step.view, step.height) == (View(50_000, 30_000, 90_000, 480 * 320), 320)
    assert step.alone("raster") == pytest.approx(2.0)  # 2 alone, 3 on both: 5 ms and 8 of CPU
    assert step.alone("rest") == 0.5
    assert read_steps(printed(measured(1, 8.0, 8.0))) == []


def test_two_cores_are_as_measured_and_more_are_faster() -> None:
    (step,) = read_steps(printed(measured(1, 8.0, 8.0, 0.5), measured(2, 5.0, 8.0, 0.5)))
    two = modelled(step, CHIPS["2 equal cores"])
    assert two["raster"].time == pytest.approx(5.0)
    assert two["rest"].time == 0.5
    times = [sum(m.time for m in modelled(step, (1.0,) * n).values()) for n in (1, 2, 4, 8, 16)]
    assert times == sorted(times, reverse=True)
    assert times[-1] > sum(step.alone(stage) for stage in STAGES[:-1])  # Amdahl


def test_memory_limits_what_moves_most() -> None:
    (step,) = read_steps(printed(measured(1, 8.0, 8.0), measured(2, 4.0, 8.0)))
    found = modelled(step, CHIPS["16 equal cores"], bandwidth=50.0)
    assert found["update"].time == found["update"].memory > found["update"].arithmetic
    assert found["loss"].time == found["loss"].arithmetic


def test_slow_cores_help_but_end_last() -> None:
    assert makespan(4, 1.0, (1.0, 1.0)) == 2.0
    assert makespan(3, 1.0, (1.0, 0.5)) == 2.0  # the slow core takes one task, the fast one two
    assert makespan(2, 1.0, (1.0, 0.5)) == 2.0  # it waits for the slow core


def test_bytes_are_those_of_the_parameters() -> None:
    row = synthetic_gaussians(1).tensors().values()
    assert sum(tensor.numel() * tensor.element_size() for tensor in row) == PARAMETERS
    one, two = (stage_bytes(View(n, n, 2 * n, 0)) for n in (1, 2))
    assert one["update"][1] == 3 * PARAMETERS + 4  # values, two moments, a norm
    assert {stage: (r * 2, w * 2) for stage, (r, w) in one.items()} == two


def test_the_commands(capsys: pytest.CaptureFixture[str], tmp_path) -> None:  # type: ignore[no-untyped-def]
    saved = tmp_path / "step.md"
    saved.write_text(printed(measured(1, 8.0, 8.0), measured(2, 5.0, 8.0)), encoding="utf-8")
    cores_model.main([str(saved), "--bandwidth", "50"])
    assert "16 equal cores" in capsys.readouterr().out
    saved.write_text(printed(measured(1, 8.0, 8.0)), encoding="utf-8")
    with pytest.raises(SystemExit):
        cores_model.main([str(saved)])
    assert "no step that was measured" in capsys.readouterr().err
    bandwidth.main(["--threads", "2", "--mebibytes", "1", "--passes", "1"])
    assert capsys.readouterr().out.splitlines()[-1].startswith("| 2 |")
