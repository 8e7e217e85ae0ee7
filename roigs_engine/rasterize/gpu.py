"""The backend for every GPU: compute shaders, through wgpu (Vulkan, Metal, DirectX 12).

gpu/shaders/frame.wgsl has the kernels' buffers and their order. Tensors are in main memory: the
parameters are sent to the GPU, and pictures and gradients are read back. The CPU draws outputs
without shaders (a surface, the median depth), and views with more pairs of Gaussians and tiles than
the GPU's buffers hold.
"""

from __future__ import annotations

import ctypes
import struct
import weakref
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..gpu.program import (
    BUCKET,
    JOB_BYTES,
    MOMENTS,
    PIXELS,
    ROWS,
    Commands,
    Memory,
    Program,
    open_gpu,
    opened,
)
from ..gpu.resident import NAMES
from ..kernels import bindings
from . import cpu, kernel_function
from .inputs import TILE, RenderInputs, RenderOutput

RESIDENT = {name: name for own in NAMES for name in (f"{own}_shapes", f"{own}_sh")}
GRADIENTS = {"shapes": "shape_gradients", "sh": "sh_gradients"}
CHECKPOINT = 16 * PIXELS  # bytes of a checkpoint before a bucket
SHAPE = 11  # numbers of a Gaussian besides its SH
DEPTH_BITS = 32
DEPTH_JOB, COUNT_JOB, TILE_JOB, JOBS = 0, 8, 9, 16
CAMERA_BYTES = bindings.Camera.window.offset + bindings.Camera.window.size


def render(inputs: RenderInputs) -> RenderOutput:
    """Render all cameras; see `rasterize`. Raises KernelError."""
    program = opened() or open_gpu()
    if inputs.with_surface or inputs.with_depth == "median" or not fits(program, inputs):
        inputs.settle()
        return cpu.render(inputs)
    return kernel_function.render(inputs, begin)


def fits(program: Program, inputs: RenderInputs) -> bool:
    """Whether the SH, and the picture, each fit into a buffer of the GPU."""
    left, top, right, bottom = inputs.window
    largest = max(inputs.parameters[4].numel(), 5 * (right - left) * (bottom - top))
    return 4 * largest <= program.adapter.largest


def begin(
    inputs: RenderInputs, c: int, parameters: list[Tensor], visible: Tensor
) -> kernel_function.BackendView:
    """Begin a view on the GPU, or on the CPU if it has too many pairs."""
    program = opened()
    assert program is not None
    with program.explained(f"drawing {len(parameters[0]):,} Gaussians"):
        view = CameraView(program, inputs, c, parameters, visible)
        if view.pairs < most_pairs(program.adapter.largest, view.tiles if view.keeps else 0):
            view.list_tiles()
            return view
    inputs.settle()
    return cpu.CameraView(inputs, c, parameters, visible)


def most_pairs(largest: int, tiles: int) -> int:
    """Return the number of pairs that fit into buffers of `largest` bytes, with `tiles` tiles."""
    buckets = largest // CHECKPOINT - tiles
    return min(buckets * BUCKET, largest // (4 * MOMENTS), 2**31)


class CameraView:
    """One camera's frame, from kernel to kernel; see `kernel_function.BackendView`.

    Attributes:
        pairs: number of pairs of Gaussians and tiles.
        tiles: number of tiles in the rectangle of active ones.
        keeps: whether blending writes checkpoints.
    """

    def __init__(
        self,
        program: Program,
        inputs: RenderInputs,
        c: int,
        parameters: list[Tensor],
        visible: Tensor,
    ) -> None:
        """Project for camera `c`, and count the pairs."""
        self.program, self.inputs, self.pairs = program, inputs, 0
        self.count, self._visible = len(parameters[0]), visible
        self._parameters = parameters
        self.memory = Memory.take(program)
        weakref.finalize(self, self.memory.give_back)
        self.work = Commands(self.memory)
        step = inputs.backward_step
        resident = None if step is None else step.resident
        self._is_resident = resident is not None and resident.hold(program)
        if self._is_resident and resident is not None and resident.memory is not None:
            self.memory.share(resident.memory, **RESIDENT)
        self._names = {"shapes": "values_shapes", "sh": "values_sh"} if self._is_resident else {}
        self.keeps = inputs.is_trained or inputs.with_max_weight or inputs.with_weight_sum
        left, top, right, bottom = inputs.tiles
        self.tiles = (right - left) * (bottom - top)
        x0, y0, x1, y1 = inputs.window
        self.pixels = (x1 - x0) * (y1 - y0)
        self.camera = bytes(cpu.camera_of(inputs, c))[:CAMERA_BYTES]
        if self.count and self.tiles:
            self._project()

    def _project(self) -> None:
        count, memory, work = self.count, self.memory, self.work
        mask, blocks = self.inputs.tile_mask, -(-count // ROWS)
        memory.need(
            frame=JOB_BYTES,
            job=JOBS * JOB_BYTES,
            splats=64 * count,
            **dict.fromkeys(("depths", "ranks", "pair_counts", "first_slot"), 4 * count),
            numbers=4 * (blocks + 1),
            tile_mask=4 if mask is None else 4 * self.tiles,
        )
        self._write_frame()
        if not self._is_resident:
            *shapes, sh = (parameter.numpy() for parameter in self._parameters)
            memory.need(shapes=4 * SHAPE * count, sh=sh.nbytes)
            memory.write("shapes", *shapes)
            memory.write("sh", sh)
        if mask is not None:
            memory.write("tile_mask", mask.to("cpu", torch.int32).contiguous().numpy())
        work.launch("project", blocks, self._names)
        _, self._order = work.sort("depths", "ranks", count, DEPTH_BITS, DEPTH_JOB)
        work.launch("sum_counts", blocks, {"order": self._order})
        work.set_job(COUNT_JOB, 0, 0, 0, blocks)
        work.launch("scan", 1, job=COUNT_JOB)
        total, counts = work.read(("numbers", 4, 4 * blocks), ("pair_counts", 4 * count))
        self.pairs = int(total.view(np.uint32)[0])
        torch.gt(torch.from_numpy(counts.view(np.int32)), 0, out=self._visible)

    def _write_frame(self) -> None:
        inputs = self.inputs
        flags = (
            inputs.raw,
            inputs.linear_light,
            inputs.tile_mask is not None,
            inputs.pixel_weights is not None,
            self.keeps,
        )
        sizes = self.count, inputs.parameters[4].shape[1], inputs.sh_degree
        rest = struct.pack("10I", *sizes, *map(int, flags), self.tiles, self.pairs)
        self.memory.write("frame", self.camera + rest)

    def list_tiles(self) -> None:
        """Make the tiles' lists."""
        pairs, memory, work = self.pairs, self.memory, self.work
        if not pairs:
            return
        memory.need(
            **dict.fromkeys(("tiles", "slots", "ids"), 4 * pairs),
            tile_begin=4 * (self.tiles + 1),
            reached=4 * self.tiles,
        )
        self._write_frame()
        work.launch("list_tiles", -(-self.count // ROWS), {"order": self._order})
        bits = (self.tiles - 1).bit_length()
        sorted_tiles, self._entries = work.sort("tiles", "slots", pairs, bits, TILE_JOB)
        work.launch("begin_tiles", pairs // ROWS + 1, {"sorted": sorted_tiles})

    @property
    def _buckets(self) -> int:
        """Return the largest number of groups that walk over the pixels."""
        return self.pairs // BUCKET + self.tiles

    def draw(self, outputs: kernel_function.Outputs) -> None:
        image, alpha, depth = outputs["image"], outputs["alpha"], outputs.get("depth")
        assert image is not None and alpha is not None
        if not self.pairs:
            image.copy_(self.inputs.background[:, None, None].expand_as(image))
            alpha.zero_()
            return
        inputs, planes = self.inputs, 4 if depth is None else 5
        wanted = [("picture", 4 * planes * self.pixels)]
        weighs = inputs.with_max_weight or inputs.with_weight_sum
        checkpoints = CHECKPOINT * self._buckets if self.keeps else CHECKPOINT
        self.memory.need(picture=20 * self.pixels, checkpoints=checkpoints)
        x0, y0, x1, y1 = (-(-edge // TILE) for edge in inputs.window)
        with self.program.explained(f"drawing {self.pairs:,} pairs of Gaussians and tiles"):
            self._launch("blend", (x1 - x0, y1 - y0))
            if weighs:
                self._weigh(outputs["pixel_weights"])
                wanted.append(("weights", 8 * self.count))
            picture, *weights = self.work.read(*wanted)
        drawn = torch.from_numpy(picture.view(np.float32)).view(planes, *alpha.shape)
        image.copy_(drawn[:3])
        alpha.copy_(drawn[3])
        if depth is not None:
            depth.copy_(drawn[4])
        if weighs:
            largest, sums = torch.from_numpy(weights[0].view(np.float32)).view(-1, 2).unbind(1)
            if outputs["max_weight"] is not None:
                torch.maximum(outputs["max_weight"], largest, out=outputs["max_weight"])
            if outputs["weight_sum"] is not None:
                outputs["weight_sum"] += sums

    def _launch(self, kernel: str, groups: int | tuple[int, int]) -> None:
        names = {"tile_first": "tile_begin", "entries": self._entries}
        self.work.launch(kernel, groups, names)

    def _weigh(self, pixel_weights: Tensor | None) -> None:
        self.memory.need(
            pixel_weights=4 * self.pixels,
            slot_weights=8 * self.pairs,
            weights=8 * self.count,
        )
        if pixel_weights is not None:
            self.memory.write("pixel_weights", pixel_weights.numpy())
        self._launch("weigh", self._buckets)
        self.work.launch("fold_weights", -(-self.count // ROWS))

    def blend_backward(
        self, drawn: kernel_function.Outputs, gradients: kernel_function.Outputs, grad2d: Tensor
    ) -> None:
        image = gradients["image"]
        assert image is not None
        if not self.pairs:
            return
        self.memory.need(
            picture_gradient=12 * self.pixels,
            moments=4 * MOMENTS * self.pairs,
            shape_gradients=4 * SHAPE * self.count,
            sh_gradients=self._parameters[4].nbytes,
            row_results=8 * self.count,
        )
        self._grad2d = grad2d
        with self.program.explained("taking the gradient"):
            self.memory.write("picture_gradient", image.numpy())
            self._launch("gradient", self._buckets)
            self.work.launch("project_backward", -(-self.count // ROWS), self._names)
            if not self._is_resident:
                self._read_gradients()

    def _read_rows(self, results: NDArray[np.uint8]) -> NDArray[np.uint32]:
        """Write `grad2d`; return the rows' flags (N,), whose bits frame.wgsl describes."""
        norms, flags = results.view(np.uint32).reshape(-1, 2).T
        self._grad2d.copy_(torch.from_numpy(norms.copy().view(np.float32)))
        return np.asarray(flags)

    def _read_gradients(self) -> None:
        """Read the gradients, so that a lost GPU loses nothing afterwards."""
        count, sh = self.count, self._parameters[4]
        shapes, of_sh, results = self.work.read(
            ("shape_gradients", 4 * SHAPE * count),
            ("sh_gradients", sh.nbytes),
            ("row_results", 8 * count),
        )
        widths = [3 * count, 4 * count, 3 * count, count]
        parts = torch.split(torch.from_numpy(shapes.view(np.float32)), widths)
        parts = (*parts, torch.from_numpy(of_sh.view(np.float32)))
        self._gradients = [
            part.view(p.shape) for part, p in zip(parts, self._parameters, strict=True)
        ]
        self._has_gradient = torch.from_numpy((self._read_rows(results) & 1).astype(np.uint8))

    def project_backward(self, targets: list[Tensor | None]) -> None:
        for target, gradient in zip(targets, self._gradients, strict=True) if self.pairs else ():
            if target is not None:
                target += gradient

    def take_step(self, adam: Any) -> int:
        if not self.pairs:
            return 0
        adam = adam._obj
        if self._is_resident:
            with self.program.explained("taking a step"):
                return self._step_there(adam)
        for index, gradient in enumerate(self._gradients):
            adam.parameters[index].gradient = bindings.pointer(gradient)
        rows = bindings.pointer(self._has_gradient)
        return int(bindings.kernels().roigs_adam(self.count, ctypes.byref(adam), rows))

    def _step_there(self, adam: bindings.Adam) -> int:
        """Take Adam's step on the GPU; return the number of skipped rows."""
        memory, count = self.memory, self.count
        beta1, beta2 = adam.betas
        corrections = (1 - beta2**adam.step) ** -0.5, 1 / (1 - beta1**adam.step)
        has_rates = adam.row_rates is not None
        step = struct.pack("5fI", 1 - beta1, 1 - beta2, adam.epsilon, *corrections, has_rates)
        rates = b"".join(
            ctypes.string_at(p.rates, 4 * p.width) for p in (adam.parameters[i] for i in range(5))
        )
        memory.need(step=len(step), rates=len(rates), row_rates=4 * count if has_rates else 4)
        memory.write("step", step)
        memory.write("rates", rates)
        if has_rates:
            memory.write("row_rates", (ctypes.c_float * count).from_address(adam.row_rates))
        for part, width in (("shapes", SHAPE), ("sh", self._parameters[4].shape[1] * 3)):
            names = {name: f"{name}_{part}" for name in ("values", "exp_avg", "exp_avg_sq")}
            names |= {"results": "row_results", "gradients": GRADIENTS[part]}
            self.work.launch(f"adam_{part}", -(-width * count // ROWS), names)
        (results,) = self.work.read(("row_results", 8 * count))
        flags = self._read_rows(results)
        has_gradient = flags & 1 == 1
        return sum(int(np.count_nonzero(has_gradient & (flags & 2 << k == 0))) for k in range(5))
