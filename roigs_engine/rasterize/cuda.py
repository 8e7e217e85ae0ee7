"""The CUDA backend: our CUDA kernels as one differentiable torch function.

cuda/kernels/frame.h has the kernels' interface and their order. Between them torch sorts: Gaussians
by depth, then the (Gaussian, tile) pairs by tile; both sorts are stable. How many pairs there are
is on the card: a view without a buffer for them (`cuda.pair_buffers`) waits for the number, once.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..cuda import card
from ..cuda.bindings import (
    BUCKETS,
    CAMERA_VALUES,
    COLUMNS,
    GROUP,
    MOMENTS,
    PIXELS,
    ROWS,
    SHORT_TILES,
    WARP,
    Frame,
    Step,
    address,
)
from ..errors import EngineError, KernelError
from ..kernels import bindings
from .inputs import RenderInputs, RenderOutput, gradient_targets

_MOST_PAIRS = 2**31 - 2**12  # 32-bit places in lists, and the batch behind the last one


def render(inputs: RenderInputs) -> RenderOutput:
    """Render all cameras; see `rasterize`. Raises KernelError."""
    return RenderOutput.of_planar(*_Rasterize.apply(inputs, *inputs.parameters))  # type: ignore[no-untyped-call]


@dataclass(eq=False)
class View:
    """One camera's frame, from kernel to kernel."""

    inputs: RenderInputs
    frame: Frame = field(default_factory=Frame)  # the kernels' argument
    kept: dict[str, Tensor] = field(default_factory=dict)  # the tensors that it points to
    pairs: int = 0  # of Gaussians and tiles; the buffer's capacity, if there is one
    groups: int = 0  # blocks that walk over the pixels, at most

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


def prepare(inputs: RenderInputs, c: int, parameters: list[Tensor], visible: Tensor) -> View:
    """Project and list for camera `c`; `visible` (N,) is written."""
    view, count = View(inputs), len(parameters[0])
    frame = view.frame
    frame.gaussians = bindings.packed_gaussians(parameters, inputs.sh_degree, inputs.raw)
    _set_camera(view, c)
    left, top, right, bottom = inputs.tiles
    frame.tile_count = (right - left) * (bottom - top)
    depths, counts = view.empty(count), view.empty(count, dtype=torch.int32)
    view.set(
        splats=view.empty(count, COLUMNS),
        depths=depths,
        pair_counts=counts,
        first_slot=view.empty(count, dtype=torch.int32),
        visible=visible,
    )
    if not count or not frame.tile_count:
        visible.zero_()
        return view
    view.launch("place_camera", 1, WARP)
    view.launch_rows("project")
    order = torch.sort(depths, stable=True).indices
    ends = counts[order].cumsum(0, dtype=torch.int64)
    view.set(order=order, ends=ends)
    _list(view, _count(view, ends[-1]))
    return view


def _count(view: View, total: Tensor) -> bool:
    """Set how many pairs there are, or the buffer holds; whether slots may be left."""
    step = view.inputs.backward_step
    buffer = None if step is None else step.pair_buffer
    known = None if buffer is None else buffer.capacity
    view.pairs = int(total) if known is None else known  # int() waits for the device
    if buffer is not None:
        buffer.report(view.pairs if known is None else total)
        view.set(void=buffer.void)
    return buffer is not None


def _set_camera(view: View, c: int) -> None:
    inputs, shape = view.inputs, view.frame.shape
    view.set(
        pose=inputs.viewmats[c].to(torch.float64).contiguous(),
        intrinsics=inputs.Ks[c].to(torch.float32).contiguous(),
        background=inputs.background.to(torch.float32).contiguous(),
        camera_values=view.empty(CAMERA_VALUES),
    )
    inputs.fill(shape, c)
    if inputs.tile_mask is not None:
        view.kept["mask"] = inputs.tile_mask.to(torch.uint8).contiguous()
        shape.tile_mask = address(view.kept["mask"])


def _list(view: View, may_leave_slots: bool) -> None:
    """Make the tiles' lists; slots that are left are sorted behind those of all tiles."""
    if view.pairs > _MOST_PAIRS:
        raise KernelError(
            f"This view has {view.pairs} pairs of Gaussians and tiles: more than 2^31.",
            "Render a smaller image, or fewer or smaller Gaussians.",
        )
    tiles = view.frame.tile_count
    short = tiles < SHORT_TILES
    keys = view.empty(view.pairs, dtype=torch.int16 if short else torch.int32)
    if may_leave_slots:
        keys.fill_(tiles)
    ids = view.empty(view.pairs, dtype=torch.int32)
    view.set(**{"short_tiles" if short else "tiles": keys}, ids=ids)
    view.launch_rows("list_tiles")
    by_tile, entries = torch.sort(keys, stable=True)
    view.groups = view.pairs // GROUP + tiles  # the number itself is on the device
    view.frame.pairs = view.pairs
    view.set(
        **{"short_sorted" if short else "sorted": by_tile},
        entries=entries,
        tile_begin=view.empty(tiles + 1, dtype=torch.int32),
        group_begin=view.empty(tiles + 1, dtype=torch.int32),
        reached=view.empty(tiles, dtype=torch.int32),
    )
    view.launch("begin_tiles", view.pairs // ROWS + 1, ROWS)
    view.launch("begin_groups", 1, PIXELS)


def blend(view: View, outputs: dict[str, Tensor | None], *, walked: bool) -> None:
    """Draw a prepared view into the tensors of `outputs`, which hold background.

    `walked`: weights or gradients are wanted, of this view or later.
    """
    if not view.pairs:
        return
    if walked:
        view.set(checkpoints=view.empty(view.groups, BUCKETS, PIXELS, 4))
    median = outputs.pop("median", None)
    view.frame.out = bindings.Outputs(**{name: address(t) for name, t in outputs.items()})
    view.kept.update({f"out {name}": t for name, t in outputs.items() if t is not None})
    view.launch("blend", view.frame.tile_count, PIXELS)
    if median is not None:
        view.set(median=median)
        view.launch("median_depth", view.frame.tile_count, PIXELS)
    if outputs["max_weight"] is not None or outputs["weight_sum"] is not None:
        view.set(slot_largest=view.empty(view.pairs), slot_sums=view.empty(view.pairs))
        view.launch("weigh", view.groups, GROUP)
        view.launch_rows("fold_weights")


class _Rasterize(torch.autograd.Function):
    """(inputs, five parameters) -> planar image (C, 3, H, W), and outputs without gradient."""

    @staticmethod
    def forward(ctx: Any, inputs: RenderInputs, *parameters: Tensor) -> tuple[Tensor | None, ...]:
        means, views = parameters[0], len(inputs.viewmats)
        size, count = (inputs.height, inputs.width), len(means)
        image = inputs.background.to(means.dtype).view(1, 3, 1, 1).expand(views, 3, *size).clone()
        alpha = means.new_zeros(views, *size)
        depth = torch.zeros_like(alpha) if inputs.with_depth else None
        visible = torch.empty(views, count, dtype=torch.bool, device=means.device)
        grad2d = means.new_zeros(views, count)
        max_weight = means.new_zeros(count) if inputs.with_max_weight else None
        weight_sum = means.new_zeros(count) if inputs.with_weight_sum else None
        pixel_weights = inputs.pixel_weights
        if pixel_weights is not None:
            pixel_weights = pixel_weights.to(torch.float32).contiguous()
        kind = "median" if inputs.with_depth == "median" else "depth"
        walked = any(ctx.needs_input_grad) or inputs.with_max_weight or inputs.with_weight_sum
        packed = [p.detach().contiguous() for p in parameters]
        ctx.inputs, ctx.views, ctx.grad2d = inputs, [], grad2d
        for c in range(views):
            view = prepare(inputs, c, packed, visible[c])
            outputs: dict[str, Tensor | None] = {
                "image": image[c],
                "alpha": alpha[c],
                "max_weight": max_weight,
                "weight_sum": weight_sum,
                "pixel_weights": None if pixel_weights is None else pixel_weights[c],
            }
            if depth is not None:
                outputs[kind] = depth[c]
            blend(view, outputs, walked=walked)
            if any(ctx.needs_input_grad):
                ctx.views.append(view)
        ctx.save_for_backward(*parameters)
        statistics = (alpha, visible, grad2d, depth, max_weight, weight_sum)
        ctx.mark_non_differentiable(*(t for t in statistics if t is not None))
        ctx.set_materialize_grads(False)
        return image, *statistics

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *output_gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        image_gradient, parameters = output_gradients[0], ctx.saved_tensors
        if image_gradient is None:
            return (None,) * (1 + len(parameters))
        if ctx.views is None:
            raise EngineError("rasterize: backward() can be called only once on this backend.")
        views, ctx.views = ctx.views, None
        gradient = image_gradient.to(torch.float32).contiguous()  # planar: no copy
        step = ctx.inputs.backward_step
        needed = [step is None and each for each in ctx.needs_input_grad[1:]]
        targets = gradient_targets(parameters, needed)
        for c, view in enumerate(views):
            view.set(image_gradient=gradient[c], grad2d=ctx.grad2d[c])
            if view.pairs:
                view.set(moments=view.empty(view.pairs, MOMENTS))
                view.launch("gradient", view.groups, GROUP)
            if step is not None:
                step.take(lambda adam, view=view: _take_step(view, adam._obj))
            elif view.pairs:
                buffers = (address(buffer) for buffer, _ in targets)
                view.frame.gradients = bindings.Gradients(*buffers)
                view.launch_rows("project_backward")
        return (None, *(buffer if is_fresh else None for buffer, is_fresh in targets))


def _take_step(view: View, adam: bindings.Adam) -> Tensor:
    """Adam's step with the gradient; returns the number of skipped rows, on the device."""
    skipped = torch.zeros((), dtype=torch.int32, device=view.device)
    if not view.pairs:
        return skipped
    beta1, beta2 = adam.betas
    step = Step(
        frame=view.frame,
        parameters=(bindings.AdamParameter * 5)(*adam.parameters[:5]),
        add1=1 - beta1,
        add2=1 - beta2,
        epsilon=adam.epsilon,
        inverse_sqrt_correction2=(1 - beta2**adam.step) ** -0.5,
        rate_scale=1 / (1 - beta1**adam.step),
        skipped=address(skipped),
        row_rates=adam.row_rates,
    )
    blocks = -(-view.frame.gaussians.count // ROWS)
    card.program(view.device).launch("project_backward_adam", blocks, ROWS, step)
    return skipped
