"""The pieces of benchmarks/ run, and count what they say; nothing is timed for its speed."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import pytest
import torch

from benchmarks import cuda_step, flops, gpu, large_capture, step, tables
from benchmarks.measure import COUNTS, StepBenchmark, kernel_calls, optional_outputs, peak_memory
from benchmarks.results import STAGES, Measurement, Row, growth
from benchmarks.synthetic import CAMERAS
from roigs_engine.colmap.project import load_colmap
from roigs_engine.commands.parser import build_parser
from roigs_engine.errors import KernelError
from roigs_engine.kernels import build, library
from roigs_engine.rasterize import rasterize

LANES = {"avx512": 16, "avx2": 8, "generic": 4, "neon": 4}  # simd.h: kLanes


@pytest.fixture(scope="module")
def tiny() -> StepBenchmark:
    torch.set_num_threads(1)
    return StepBenchmark(2_000, 64, 48)


def counted_pairs(means: torch.Tensor, opacity: float, **options: bool) -> int:
    """Pair evaluations of tiny round Gaussians, seen by a camera with 16 px per unit at z = 1."""
    n = len(means)
    pairs = 0

    def count(view, name, call):  # type: ignore[no-untyped-def]
        nonlocal pairs
        result = call()
        if name == "roigs_render":
            pairs = view.call("roigs_pair_evaluations")
        return result

    with kernel_calls(count):
        rasterize(
            means,
            torch.tensor([[1.0, 0.0, 0.0, 0.0]]).expand(n, 4),
            torch.full((n, 3), 1e-3),
            torch.full((n,), opacity),
            torch.zeros(n, 1, 3),
            torch.eye(4)[None],
            torch.tensor([[[16.0, 0, 16], [0, 16.0, 16], [0, 0, 1]]]),
            32,
            32,
            backend="cpu",
            **options,
        )
    return pairs


def test_a_step_has_all_stages(tiny: StepBenchmark) -> None:
    before = {name: tensor.detach().clone() for name, tensor in tiny.model.tensors().items()}
    times = tiny.step_times()
    assert len(times) == CAMERAS
    assert all(set(t) == set(STAGES) for t in times)
    wall = [sum(t[stage][0] for stage in STAGES if stage != "step") for t in times]
    assert wall == pytest.approx([t["step"][0] for t in times])
    after = tiny.model.tensors()
    assert all(torch.equal(after[name], tensor) for name, tensor in before.items())


def test_counts_do_not_depend_on_threads(tiny: StepBenchmark) -> None:
    threads = library.threads()
    try:
        library.set_threads(1)
        alone = tiny.counts()
        library.set_threads(4)
        assert tiny.counts() == alone
    finally:
        library.set_threads(threads)
    assert set(alone) == set(COUNTS.values())
    lanes = LANES[library.isa()]
    assert all(pairs > 0 and pairs % lanes == 0 for pairs in alone["pairs"])


def test_pairs_are_lanes_of_visited_blocks() -> None:
    middle = torch.tensor([[0.06, 0.06, 1.0]])  # px (16.96, 16.96)
    lanes = LANES[library.isa()]
    faint = counted_pairs(middle, 0.01)
    assert faint == lanes
    assert counted_pairs(middle.expand(10, 3), 0.01) == 10 * lanes
    assert counted_pairs(torch.tensor([[0.0, 0.0, -1.0]]), 0.9) == 0
    assert counted_pairs(torch.zeros(0, 3), 0.9) == 0


def test_extras_are_what_rasterize_offers(tiny: StepBenchmark) -> None:
    options = optional_outputs()
    assert options["plain"] == {}
    assert options["depth"] == {"with_depth": True}
    assert options["depth + max_weight"] == {"with_depth": True, "with_max_weight": True}
    assert options["median depth"] == {"with_depth": "median"}
    times = tiny.extras_times()
    assert all(set(t) == set(options) for t in times)
    for name in ("plain", "median depth"):
        assert set(times[0][name]) == {"render", "project", "bin", "raster"}


@pytest.mark.slow
def test_peak(tmp_path: Path) -> None:
    try:
        with flops.peak_libraries() as libraries:
            peak = flops.peak_gflops(libraries[library.isa()])
            assert set(libraries) == set(build.PLATFORMS[build.native_platform()].isas)
    except build.BuildError as error:
        pytest.skip(f"no compiler: {error}")
    assert 0.1 < peak < 10_000


def test_peak_memory() -> None:
    memory = peak_memory()
    assert memory is None or memory > 1e7


def measurement(gaussians: int, visible: int, pairs: int, milliseconds: float) -> Measurement:
    """Every stage takes `milliseconds`, seen by one camera in two rounds, the first disturbed."""
    m = Measurement(
        Row(gaussians, 100, 10, 1),
        "this",
        "avx2",
        {"visible": [visible], "intersections": [3 * visible], "pairs": [pairs]},
        peak=100.0,
        memory=2_000_000,
    )
    for slower in (2, 1):
        times = (milliseconds * slower, milliseconds * slower)
        m.rounds.append([dict.fromkeys(STAGES, times)])
        m.extras.append([{"plain": {"raster": times, "render": times}}])
    return m


def test_numbers_of_the_tables() -> None:
    m = measurement(1_000, 500, 2_000_000, 4.0)
    assert m.milliseconds("raster", 0) == 4.0
    assert m.median("raster", 0) == 6.0
    assert m.nanoseconds_per_pair("raster") == pytest.approx(2.0)
    assert m.share_of_peak(["raster"]) == pytest.approx(flops.FORWARD / 2.0 / 100)
    both = (flops.FORWARD + flops.BACKWARD) / 4.0 / 100
    assert m.share_of_peak(["raster", "raster backward"]) == pytest.approx(both)
    for table in (tables.stage_table, tables.work_table, tables.ratio_table):
        lines = table([m, measurement(1_000, 500, 1_000, 8.0)]).splitlines()
        assert len({line.count("|") for line in lines}) == 1
    assert "2.000 (2.000)" in lines[-1]


def test_growth_tells_linear_from_faster() -> None:
    sizes = [(100, 10_000), (400, 90_000), (5_000, 300_000), (9_000, 1_000_000)]
    linear = [measurement(v, v, p, 1e-4 * v + 2e-6 * p) for v, p in sizes]
    fit = growth(linear)
    assert fit is not None
    assert (fit.per_visible, fit.per_pair) == pytest.approx((100.0, 2.0))
    assert fit.exponent == pytest.approx(1.0)
    faster = growth([measurement(v, v, p, (1e-4 * v + 2e-6 * p) ** 1.5) for v, p in sizes])
    assert faster is not None and faster.exponent > 1.3
    assert growth(linear[:2]) is None
    assert len(tables.growth_table(linear).splitlines()) == 2 + len(sizes)


@pytest.mark.slow
def test_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    tiny_row = ["--gaussians", "2000", "--size", "64x48", "--threads", "1", "--rounds", "1"]
    step.main([*tiny_row, "--isa", library.isa(), library.available(library.PACKAGE_FOLDER)[0]])
    assert "Medians relative to" in capsys.readouterr().out
    step.main([*tiny_row, "--extras"])
    assert "max_weight" in capsys.readouterr().out


def test_the_step_on_a_gpu_is_measured_by_what_runs_anywhere() -> None:
    """The engine's side of it, on the CPU; the bare step needs gsplat."""
    row = cuda_step.measure(500, (64, 48), 2, torch.device("cpu"), [cuda_step.our_step])
    assert len(row.ours) == 2 and min(row.ours) > 0 and not row.bare
    row.bare = [2 * t for t in row.ours]
    row.waits, row.kernels = 1, 0.97
    last = cuda_step.table([row]).splitlines()[-1]
    assert last.startswith("| 500 | 64x48 |") and "| 2.00 | 97% | 1 |" in last


def test_without_a_gpu_the_step_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.version, "cuda", None)
    with pytest.raises(KernelError, match="without CUDA"):
        step.main(["--device", "cuda"])


def test_the_photos_of_a_large_capture_are_all_different(tmp_path: Path) -> None:
    large_capture.write_scene(tmp_path, 7, 120, 80)
    scene = load_colmap(tmp_path, cache=tmp_path / "cache")
    assert len(scene.images) == len({image.digest for image in scene.images}) == 7
    assert scene.skipped == {}


def code(name: str, text: str, minutes: float = 1) -> gpu.Part:
    return gpu.Part(name=name, command=("-c", text), minutes=minutes)


def test_a_gpu_is_measured_part_by_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A part that fails, hangs or is killed does not stop the others; all leave figures."""
    found = [
        code("good", "print('12 ms')"),
        code("bad", "print('7 ms'); raise SystemExit(2)"),
        code("killed", "print('8 ms'); import os; os.kill(os.getpid(), 9)"),
        code("slow", "print('9 ms'); import time; time.sleep(60)", minutes=0.02),
        code("a/b", "print('no such folder')"),
        code("bar", r"print('1\r2\r3 %'); import os; os.write(1, bytes([255, 10]))"),
        code("last", "print('10 ms')"),
    ]
    monkeypatch.setattr(gpu, "parts", lambda scene, out, gsplat: found)
    assert gpu.main(["--out", str(tmp_path)]) == 1
    summary = (tmp_path / "summary.md").read_text()
    for line in ("| good | 0 |", "| bad | 2 |", "| killed | -9 |", "| slow | ended after 0.0 min"):
        assert line in summary
    assert "| a/b | not started (" in summary and "| last | 0 |" in summary
    for figure in ("12 ms", "7 ms", "8 ms", "9 ms", "10 ms", "\n3 %\n"):
        assert figure in summary
    assert gpu.main(["--out", str(tmp_path), "--only", "good"]) == 0


def test_a_gpu_without_time_keeps_what_comes_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = [code("first", "print('12 ms')"), code("slow", "import time; time.sleep(60)")]
    found += [code("never", "print('1 ms')")]
    monkeypatch.setattr(gpu, "parts", lambda scene, out, gsplat: found)
    monkeypatch.setattr(gpu, "LEAST_SECONDS", 0.5)
    assert gpu.main(["--out", str(tmp_path), "--minutes", "0.03"]) == 1
    summary = (tmp_path / "summary.md").read_text()
    assert "12 ms" in summary and "| slow | ended after" in summary
    assert "| never | no time left | 0.0 |" in summary and not (tmp_path / "never.txt").exists()


def test_nvidia_smi_may_be_broken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpu.shutil, "which", lambda name: str(tmp_path / "missing"))
    assert gpu.do(code("good", "print('12 ms')"), tmp_path).status == "0"


def test_the_most_valuable_figures_come_first(tmp_path: Path) -> None:
    names = [part.name for part in gpu.parts(tmp_path, tmp_path, gsplat=True)]
    assert names[:3] == ["check-gpu", "step-1000k-1280x853", "tests"] and names[-1] == "paper"
    rows = [f"step-{k}k-{size}" for size in gpu.SIZES for k in (100, 1000, 4000)]
    assert {*rows, *(f"{row}-gsplat" for row in rows)} < set(names)
    assert names.index("gsplat-compiles") > max(names.index(row) for row in rows)
    alone = [part.name for part in gpu.parts(None, tmp_path, gsplat=False)]
    assert alone == names[: names.index("gsplat-compiles")]


def test_the_parts_are_commands_that_exist(tmp_path: Path) -> None:
    root = Path(__file__).resolve().parents[1]
    parser, _ = build_parser()
    for part in gpu.parts(tmp_path, tmp_path, gsplat=True):
        module, rest = part.command[1], part.command[2:]
        if module == "roigs_engine":
            parser.parse_args(rest)
        if module == "pytest":
            assert (root / rest[-1]).is_file()
        if module == "benchmarks.step":
            step._options(rest)
        if module == "benchmarks.first_use":
            assert find_spec(module)
