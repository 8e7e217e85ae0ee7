"""The shaders on a GPU: compiled kernels, buffers, launches, results.

The shaders are WGSL, in separate files. All kernels of a file share its buffers; a kernel names
those that it uses.
"""

from __future__ import annotations

import functools
import hashlib
import re
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..errors import GpuMemoryError, KernelError
from ..kernels.build import SOURCE_FOLDER
from .adapters import STORAGE_BUFFERS, Adapter, find, wgpu

FOLDER = Path(__file__).parent / "shaders"
PIXELS = 256  # pixels of a tile, and threads of a group that blends it
ROWS = 128  # Gaussians of a group
BUCKET = 64  # entries of a tile's list that a group processes together
MOMENTS = 9  # moments of a slot
SORT_BLOCK = 2048  # numbers that a group sorts
DIGIT_BITS, DIGITS = 4, 16
GROUPS_IN_ROW = 32768  # groups in a row of a launch; at most 65535 groups in a row, and rows
SIZES = {
    "PIXELS": PIXELS,
    "ROWS": ROWS,
    "BUCKET": BUCKET,
    "MOMENTS": MOMENTS,
    "SORT_BLOCK": SORT_BLOCK,
    "GROUPS_IN_ROW": GROUPS_IN_ROW,
}
JOB_BYTES = 256  # alignment of offsets at which kernels use a buffer
LEAST_BYTES = 1024
MARGIN = 1.25  # a buffer that must grow gets this multiple of the needed size

_SPLATS = "frame splats"
_LISTS = f"{_SPLATS} tile_first entries ids reached checkpoints"
_ADAM = "frame step rates row_rates results gradients values exp_avg exp_avg_sq"
_SORT = "job keys_in values_in keys_out values_out numbers"
KERNELS: dict[str, tuple[str, str]] = {
    "project": (
        "frame geometry project",
        "frame shapes sh splats depths ranks pair_counts tile_mask",
    ),
    "sum_counts": ("frame geometry project", "frame pair_counts order numbers"),
    "list_tiles": (
        "frame geometry project",
        f"{_SPLATS} pair_counts first_slot tile_mask order numbers tiles slots ids",
    ),
    "begin_tiles": ("frame geometry project", "frame sorted tile_begin"),
    "count_digits": ("sort", "job keys_in numbers"),
    "scan": ("sort", "job numbers"),
    "scatter": ("sort", _SORT),
    "blend": ("frame blend", f"{_LISTS} picture"),
    "gradient": ("frame walk", f"{_LISTS} moments picture picture_gradient"),
    "weigh": ("frame walk", f"{_LISTS} pixel_weights slot_weights"),
    "fold_weights": ("frame walk", "frame pair_counts first_slot slot_weights weights"),
    "project_backward": (
        "frame geometry backward",
        f"{_SPLATS} shapes sh pair_counts first_slot moments"
        " shape_gradients sh_gradients row_results",
    ),
    "adam_shapes": ("frame adam", _ADAM),
    "adam_sh": ("frame adam", _ADAM),
}
"""Name of a kernel -> its source files, and its buffers."""


def _constants() -> dict[str, str]:
    """The constants of kernels/constants.h: name in WGSL -> value."""
    text = (SOURCE_FOLDER / "constants.h").read_text(encoding="utf-8")
    found = {}
    for name, value in re.findall(r"constexpr \w+ k(\w+) = ([-+.\de]+)f?;", text):
        found[re.sub(r"(?<=[a-z\d])(?=[A-Z])", "_", name).upper()] = value
    return found


@functools.cache
def source(files: str) -> str:
    """The text of a module, preceded by the constants."""
    values = {**_constants(), **SIZES}
    lines = [f"const {name} = {value};\n" for name, value in values.items()]
    texts = [(FOLDER / f"{name}.wgsl").read_text(encoding="utf-8") for name in files.split()]
    return "".join((*lines, *texts))


@functools.cache
def source_key() -> str:
    """A hash of all shaders, and of the sizes of launches."""
    texts = [source(files) for files, _ in sorted(KERNELS.values())]
    return hashlib.sha256("".join(texts).encode()).hexdigest()


@functools.cache
def _bindings(files: str) -> dict[str, int]:
    """Name of a buffer -> its binding number in the sources."""
    found = re.findall(r"@binding\((\d+)\) var<[^>]*> (\w+)", source(files))
    return {name: int(number) for number, name in found}


class Program:
    """The kernels on a GPU.

    Attributes:
        has_failed: whether the GPU was lost, or an operation failed.
    """

    has_failed = False

    def __init__(self, adapter: Adapter) -> None:
        """Open the GPU. KernelError: it cannot be opened, or does not accept the shaders."""
        self.adapter, self.library = adapter, wgpu()
        limits = {
            "max-storage-buffers-per-shader-stage": STORAGE_BUFFERS,
            "max-storage-buffer-binding-size": adapter.largest,
            "max-buffer-size": adapter.largest,
        }
        self._modules: dict[str, Any] = {}
        self.pipelines: dict[str, Any] = {}
        self._staging: Any = None
        with self.explained("opening it"):
            self.device = adapter.handle.request_device_sync(required_limits=limits)
            for kernel, (files, _) in KERNELS.items():
                self.pipelines[kernel] = self._compiled(kernel, files)

    def explained(self, doing: str) -> _Explained:
        """Context manager that turns wgpu's errors into a KernelError; `doing`: for its message."""
        return _Explained(self, doing)

    def _compiled(self, kernel: str, files: str) -> Any:
        if files not in self._modules:
            self._modules[files] = self.device.create_shader_module(code=source(files))
        stage = {"module": self._modules[files], "entry_point": kernel}
        return self.device.create_compute_pipeline(layout="auto", compute=stage)

    def new_buffer(self, size: int) -> Any:
        usage = self.library.BufferUsage
        size = -(-max(size, LEAST_BYTES) // JOB_BYTES) * JOB_BYTES
        return self.device.create_buffer(
            size=size, usage=usage.STORAGE | usage.COPY_SRC | usage.COPY_DST
        )

    def read(self, encoder: Any, wanted: Sequence[tuple[Any, int, int]]) -> list[NDArray[np.uint8]]:
        """Submit the encoded commands, wait, and read bytes of buffers: (buffer, first, size).

        Sizes are multiples of 4. The caller may change the arrays.
        """
        total = sum(size for _, _, size in wanted)
        if self._staging is None or self._staging.size < total:
            usage = self.library.BufferUsage
            self._staging = self.device.create_buffer(
                size=max(int(MARGIN * total) // 8 * 8 + 8, LEAST_BYTES),
                usage=usage.MAP_READ | usage.COPY_DST,
            )
        place = 0
        for buffer, first, size in wanted:
            encoder.copy_buffer_to_buffer(buffer, first, self._staging, place, size)
            place += size
        self.device.queue.submit([encoder.finish()])
        self._staging.map_sync(self.library.MapMode.READ, 0, -(-total // 8) * 8)
        try:
            whole = np.frombuffer(self._staging.read_mapped(copy=True), dtype=np.uint8)
        finally:
            self._staging.unmap()
        ends = np.cumsum([size for _, _, size in wanted])
        return [whole[end - size : end] for end, (_, _, size) in zip(ends, wanted, strict=True)]


class _Explained:
    """Turns wgpu's errors into a KernelError, or a GpuMemoryError if memory is full."""

    def __init__(self, program: Program, doing: str) -> None:
        self._program, self._doing = program, doing

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: Any, error: BaseException | None, _: Any) -> None:
        if error is None or isinstance(error, KernelError):
            return
        title = self._program.adapter.title
        if isinstance(error, MemoryError):
            raise GpuMemoryError(
                f"The memory of {title} is full: {self._doing}.",
                "Close other programs that use the GPU, or use smaller photos (--max-side) or"
                " the CPU (--device cpu).",
            ) from error
        if isinstance(error, (self._program.library.GPUError, RuntimeError)):
            self._program.has_failed = True
            last = (str(error).strip().splitlines() or ["unknown error"])[-1].strip(" .:")
            raise KernelError(
                f"{title}, failed while {self._doing}: {last}.",
                "Update its driver, or use the CPU (--device cpu), which resumes.",
            ) from error


class Memory:
    """Named buffers of a view. They grow, and are reused for the next view.

    New buffers cost more: the driver must clear them, and they need new bind groups.
    """

    _idle: ClassVar[list[Memory]] = []
    _MOST_IDLE: ClassVar[int] = 2

    def __init__(self, program: Program) -> None:
        self.program = program
        self._buffers: dict[str, Any] = {}
        self._groups: dict[tuple[Any, ...], Any] = {}

    @classmethod
    def take(cls, program: Program) -> Memory:
        """The memory released last, or a new one."""
        while cls._idle:
            memory = cls._idle.pop()
            if memory.program is program:
                return memory
        return cls(program)

    def give_back(self) -> None:
        """Release it for the next `take`; its contents are lost."""
        if len(self._idle) < self._MOST_IDLE:
            self._idle.append(self)

    def need(self, **sizes: int) -> None:
        """Provide buffers of at least these sizes, bytes; one that must grow loses its content."""
        for name, size in sizes.items():
            old = self._buffers.get(name)
            if old is not None and old.size >= size:
                continue
            largest = self.program.adapter.largest // JOB_BYTES * JOB_BYTES
            if size > largest:
                raise KernelError(
                    f"A buffer of {size / 1e6:,.0f} MB is too large for"
                    f" {self.program.adapter.title}, which takes {largest / 1e6:,.0f} MB.",
                    "Use smaller photos (--max-side) or the CPU (--device cpu).",
                )
            if old is not None:
                old.destroy()
                self._groups.clear()
            self._buffers[name] = self.program.new_buffer(min(int(MARGIN * size), largest))

    def share(self, other: Memory, **names: str) -> None:
        """Use buffers of another memory; `names`: own name, which no `need` has -> other's name."""
        for own, name in names.items():
            if self._buffers.get(own) is not other[name]:
                self._buffers[own] = other[name]
                self._groups.clear()

    def __getitem__(self, name: str) -> Any:
        return self._buffers[name]

    def write(self, name: str, *arrays: Any, at: int = 0) -> None:
        """Copy arrays into a buffer, one after the other; their sizes are multiples of 4 bytes."""
        buffer, queue = self._buffers[name], self.program.device.queue
        for array in arrays:
            view = memoryview(array).cast("B")
            if view.nbytes:
                queue.write_buffer(buffer, at, view)
            at += view.nbytes

    def group(self, kernel: str, names: Mapping[str, str], job: int) -> Any:
        """The bind group of a kernel; `names`: name in the shader -> buffer, where they differ."""
        files, used = KERNELS[kernel]
        key = (kernel, job, *(names.get(own, own) for own in used.split()))
        if key not in self._groups:
            numbers, entries = _bindings(files), []
            for own in used.split():
                buffer = self._buffers[names.get(own, own)]
                whole = {"buffer": buffer, "offset": 0, "size": buffer.size}
                if own == "job":
                    whole |= {"offset": job * JOB_BYTES, "size": JOB_BYTES}
                entries.append({"binding": numbers[own], "resource": whole})
            layout = self.program.pipelines[kernel].get_bind_group_layout(0)
            self._groups[key] = self.program.device.create_bind_group(
                layout=layout, entries=entries
            )
        return self._groups[key]


class Commands:
    """Collects launches, and runs them when something is read."""

    def __init__(self, memory: Memory) -> None:
        self._memory, self._program = memory, memory.program
        self._encoder: Any = None
        self._pass: Any = None

    def launch(
        self,
        kernel: str,
        groups: int | tuple[int, int],
        names: Mapping[str, str] | None = None,
        *,
        job: int = 0,
    ) -> None:
        """Add the launch of a kernel after the earlier ones.

        Args:
            groups: number of groups, or (columns, rows).
            names: name in the shader -> buffer, where they differ.
            job: index of its arguments in the buffer `job`.
        """
        if self._pass is None:
            self._encoder = self._program.device.create_command_encoder()
            self._pass = self._encoder.begin_compute_pass()
        if isinstance(groups, int):
            groups = min(groups, GROUPS_IN_ROW), -(-groups // GROUPS_IN_ROW)
        self._pass.set_pipeline(self._program.pipelines[kernel])
        self._pass.set_bind_group(0, self._memory.group(kernel, names or {}, job))
        self._pass.dispatch_workgroups(*groups, 1)

    def sort(self, keys: str, values: str, count: int, bits: int, job: int) -> tuple[str, str]:
        """Sort `count` keys of `bits` bits with their values; returns the sorted buffers' names.

        The buffer `job` must have a free entry for each digit, from index `job` on.
        """
        blocks = -(-count // SORT_BLOCK)
        other = f"{keys}_other", f"{values}_other"
        self._memory.need(**dict.fromkeys(other, 4 * count), digits=4 * (DIGITS * blocks + 1))
        now = keys, values
        for place, shift in enumerate(range(0, bits, DIGIT_BITS), start=job):
            self.set_job(place, count, shift, blocks, DIGITS * blocks)
            names = {"keys_in": now[0], "values_in": now[1], "numbers": "digits"}
            names |= {"keys_out": other[0], "values_out": other[1]}
            self.launch("count_digits", blocks, names, job=place)
            self.launch("scan", 1, names, job=place)
            self.launch("scatter", blocks, names, job=place)
            now, other = other, now
        return now

    def set_job(self, job: int, *values: int) -> None:
        """Set a kernel's arguments for sort.wgsl: once per index until the next `read`."""
        self._memory.write("job", struct.pack("4I", *values), at=job * JOB_BYTES)

    def read(self, *wanted: tuple[str, int] | tuple[str, int, int]) -> list[NDArray[np.uint8]]:
        """Run all launches, and read bytes of buffers: name, size, and optionally first byte."""
        if self._pass is None:
            self._encoder = self._program.device.create_command_encoder()
        else:
            self._pass.end()
        encoder, self._encoder, self._pass = self._encoder, None, None
        places = [(self._memory[name], *(first or (0,)), size) for name, size, *first in wanted]
        return self._program.read(encoder, places)


_opened: list[Program] = []
_program = functools.cache(Program)


def open_gpu(name: str = "") -> Program:
    """Draw with a GPU from now on; `name` and KernelError as in `adapters.find` and `Program`."""
    close_gpu()
    _opened[:] = [_program(find(name))]
    return _opened[0]


def close_gpu() -> None:
    """Draw with the processor from now on."""
    if any(program.has_failed for program in _opened):
        _program.cache_clear()
    _opened.clear()


def drawing(device: str) -> str:
    """The backend for a device's tensors: "gpu" if a GPU draws for the CPU, else the device."""
    return "gpu" if device == "cpu" and _opened else device


def opened() -> Program | None:
    """The GPU that draws for this process; None: the processor draws."""
    return _opened[0] if _opened else None
