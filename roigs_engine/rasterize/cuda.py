"""The CUDA backend: our CUDA kernels.

cuda/kernels/frame.h has the kernels' interface and their order. Between them, torch sorts Gaussians
by depth, then (Gaussian, tile) pairs by tile; both sorts are stable. The number of pairs is only
known on the card: a view without a buffer for them (`cuda.pair_buffers`) waits for it, once.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ..cuda import card
from ..cuda.bindings import (
    BUCKETS,
    CAMERA_VALUES,
    COLUMNS,
    GROUP,
    MOMENTS,
    PIXELS,
    PLANE_COLUMNS,
    PLANE_MOMENTS,
    ROWS,
    SHORT_TILES,
    WARP,
    Frame,
    Step,
    address,
)
from ..errors import KernelError
from ..kernels import bindings
from ..model.gaussians import NAMES
from . import kernel_function
from .inputs import RenderInputs, RenderOutput

_MOST_PAIRS = 2**31 - 2**12  # positions in lists have 32 bits, also in the batch after the last


def render(inputs: RenderInputs) -> RenderOutput:
    """Render all cameras; see `rasterize`. Raises KernelError."""
    whole = replace(inputs, window=(0, 0, inputs.width, inputs.height))
    return kernel_function.render(whole, CameraView)


class CameraView:
    """One camera's frame, from kernel to kernel; see `kernel_function.BackendView`.

    Attributes:
        frame: the kernels' argument.
        kept: the tensors that it points to.
        pairs: number of pairs of Gaussians and tiles; the buffer's capacity, if there is one.
        groups: largest number of blocks that walk over the pixels.
    """

    def __init__(
        self, inputs: RenderInputs, c: int, parameters: list[Tensor], visible: Tensor
    ) -> None:
        """Project and list for camera `c`."""
        self.inputs, self.frame, self.pairs, self.groups = inputs, Frame(), 0, 0
        self.kept = dict(zip(NAMES, parameters, strict=True))
        frame, count = self.frame, len(parameters[0])
        frame.gaussians = bindings.packed_gaussians(
            parameters, inputs.sh_degree, inputs.raw, inputs.linear_light
        )
        self._set_camera(c)
        left, top, right, bottom = inputs.tiles
        frame.tile_count = (right - left) * (bottom - top)
        depths, counts = self.empty(count), self.empty(count, dtype=torch.int32)
        self.set(
            splats=self.empty(count, COLUMNS),
            depths=depths,
            pair_counts=counts,
            first_slot=self.empty(count, dtype=torch.int32),
            visible=visible,
        )
        if not count or not frame.tile_count:
            return
        self.launch("place_camera", 1, WARP)
        self.launch_rows("project")
        order = torch.sort(depths, stable=True).indices
        ends = counts[order].cumsum(0, dtype=torch.int64)
        self.set(order=order, ends=ends)
        self.list_tiles(may_leave_slots=self._count(ends[-1]))

    @property
    def device(self) -> torch.device:
        return self.inputs.means.device

    def set(self, **tensors: Tensor | None) -> None:
        """Point fields of the frame to tensors."""
        for name, tensor in tensors.items():
            setattr(self.frame, name, address(tensor))
            if tensor is not None:
                self.kept[name] = tensor

    def empty(self, *shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
        return torch.empty(*shape, dtype=dtype, device=self.device)

    def launch(self, kernel: str, blocks: int, threads: int) -> None:
        card.program(self.device).launch(kernel, blocks, threads, self.frame)

    def launch_rows(self, kernel: str) -> None:
        """Launch a kernel with a thread for each Gaussian."""
        self.launch(kernel, -(-self.frame.gaussians.count // ROWS), ROWS)

    def _count(self, total: Tensor) -> bool:
        """Set the number of pairs or the buffer's capacity; return whether slots may stay empty."""
        step = self.inputs.backward_step
        buffer = None if step is None else step.pair_buffer
        known = None if buffer is None else buffer.capacity
        self.pairs = int(total) if known is None else known  # int() waits for the device
        if buffer is not None:
            buffer.report(self.pairs if known is None else total)
            self.set(void=buffer.void)
        return buffer is not None

    def _set_camera(self, c: int) -> None:
        inputs, shape = self.inputs, self.frame.shape
        self.set(
            pose=inputs.viewmats[c].to(torch.float64).contiguous(),
            intrinsics=inputs.Ks[c].to(torch.float32).contiguous(),
            background=inputs.background.to(torch.float32).contiguous(),
            camera_values=self.empty(CAMERA_VALUES),
        )
        inputs.fill(shape, c)
        if inputs.tile_mask is not None:
            self.kept["mask"] = inputs.tile_mask.to(torch.uint8).contiguous()
            shape.tile_mask = address(self.kept["mask"])

    def list_tiles(self, *, may_leave_slots: bool) -> None:
        """Make the tiles' lists; empty slots are sorted behind those of all tiles."""
        if self.pairs > _MOST_PAIRS:
            raise KernelError(
                f"This view has {self.pairs} pairs of Gaussians and tiles: more than 2^31.",
                "Render a smaller image, or fewer or smaller Gaussians.",
            )
        tiles = self.frame.tile_count
        short = tiles < SHORT_TILES
        keys = self.empty(self.pairs, dtype=torch.int16 if short else torch.int32)
        if may_leave_slots:
            keys.fill_(tiles)
        ids = self.empty(self.pairs, dtype=torch.int32)
        self.set(**{"short_tiles" if short else "tiles": keys}, ids=ids)
        self.launch_rows("list_tiles")
        by_tile, entries = torch.sort(keys, stable=True)
        self.groups = self.pairs // GROUP + tiles  # upper limit; the exact number is on the device
        self.frame.pairs = self.pairs
        self.set(
            **{"short_sorted" if short else "sorted": by_tile},
            entries=entries,
            tile_begin=self.empty(tiles + 1, dtype=torch.int32),
            group_begin=self.empty(tiles + 1, dtype=torch.int32),
            reached=self.empty(tiles, dtype=torch.int32),
        )
        self.launch("begin_tiles", self.pairs // ROWS + 1, ROWS)
        self.launch("begin_groups", 1, PIXELS)

    def draw(self, outputs: kernel_function.Outputs) -> None:
        inputs, median = self.inputs, outputs.pop("median", None)
        image, alpha = outputs["image"], outputs["alpha"]
        assert image is not None and alpha is not None
        image.copy_(inputs.background[:, None, None])
        alpha.zero_()
        if not self.pairs:
            return
        if inputs.is_trained or inputs.with_max_weight or inputs.with_weight_sum:
            self.set(checkpoints=self.empty(self.groups, BUCKETS, PIXELS, 4))
        self.frame.out = bindings.Outputs(**{name: address(t) for name, t in outputs.items()})
        self.launch("blend", self.frame.tile_count, PIXELS)
        if inputs.with_surface:
            if inputs.is_trained:
                shape = self.groups, BUCKETS, PIXELS, 4
                self.set(surface_checkpoints=self.empty(*shape))
            self.set(planes=self.empty(self.frame.gaussians.count, PLANE_COLUMNS))
            self.launch_rows("project_planes")
            self.launch("blend_surface", self.frame.tile_count, PIXELS)
        if median is not None:
            self.set(median=median)
            self.launch("median_depth", self.frame.tile_count, PIXELS)
        if inputs.with_max_weight or inputs.with_weight_sum:
            self.set(slot_largest=self.empty(self.pairs), slot_sums=self.empty(self.pairs))
            self.launch("weigh", self.groups, GROUP)
            self.launch_rows("fold_weights")

    def blend_backward(
        self, drawn: kernel_function.Outputs, gradients: kernel_function.Outputs, grad2d: Tensor
    ) -> None:
        surface = gradients.get("surface")
        self.set(image_gradient=gradients["image"], surface_gradient=surface, grad2d=grad2d)
        for name, tensor in drawn.items():
            setattr(self.frame.out, name, address(tensor))
        if not self.pairs:
            return
        self.set(moments=self.empty(self.pairs, MOMENTS))
        self.launch("gradient", self.groups, GROUP)
        if surface is not None:
            self.set(plane_moments=self.empty(self.pairs, PLANE_MOMENTS))
            self.launch("surface_gradient", self.groups, GROUP)

    def project_backward(self, targets: list[Tensor | None]) -> None:
        self.frame.gradients = bindings.Gradients(*map(address, targets))
        if self.pairs:
            self.launch_rows("project_backward")

    def take_step(self, adam: Any) -> Tensor:
        skipped = torch.zeros((), dtype=torch.int32, device=self.device)
        if not self.pairs:
            return skipped
        adam = adam._obj
        beta1, beta2 = adam.betas
        step = Step(
            frame=self.frame,
            parameters=(bindings.AdamParameter * 5)(*adam.parameters[:5]),
            add1=1 - beta1,
            add2=1 - beta2,
            epsilon=adam.epsilon,
            inverse_sqrt_correction2=(1 - beta2**adam.step) ** -0.5,
            rate_scale=1 / (1 - beta1**adam.step),
            skipped=address(skipped),
            row_rates=adam.row_rates,
        )
        blocks = -(-self.frame.gaussians.count // ROWS)
        card.program(self.device).launch("project_backward_adam", blocks, ROWS, step)
        return skipped
