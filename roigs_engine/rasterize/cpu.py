"""The rasterizer on compiled kernels, as one differentiable torch function.

Projection, colours, sorting and blending are one function to autograd. Their intermediate results
stay in a `KernelView` on the C++ side, whose memory is reused in each step. kernels/roigs.h has the
interface and the order of calls.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..errors import EngineError, KernelError
from ..kernels import bindings
from ..kernels.bindings import pointer
from .inputs import BackwardStep, Depth, RenderInputs, RenderOutput

_MOST_GAUSSIANS = 2**30  # rows are counted in 32 bits, some beyond the last


class KernelView:
    """The results of a forward pass that its backward pass needs, on the C++ side.

    Idle views are kept: reused memory causes no page faults, which would take longer than some of
    the kernels.
    """

    _idle: ClassVar[list[KernelView]] = []
    _MOST_IDLE: ClassVar[int] = 2
    _address: int | None = None

    def __init__(self) -> None:
        self._kernels = bindings.kernels()
        self._address = self._kernels.roigs_view_create()

    def __del__(self) -> None:
        if self._address is not None:
            self._kernels.roigs_view_destroy(self._address)

    @classmethod
    def take(cls) -> KernelView:
        """The view given back last, which may still be in the caches, or a new one."""
        try:
            return cls._idle.pop()
        except IndexError:
            return cls()

    def give_back(self) -> None:
        """Release the view for the next `take`; its contents are lost."""
        if len(self._idle) < self._MOST_IDLE:
            self._idle.append(self)

    def call(self, name: str, *arguments: Any) -> int:
        """Call a kernel on this view; raises KernelError if it fails."""
        result = getattr(self._kernels, name)(self._address, *arguments)
        if result == bindings.OUT_OF_MEMORY:
            raise KernelError("There is not enough memory to render this view.", _SMALLER)
        if result == bindings.TOO_MANY_INTERSECTIONS:
            raise KernelError(
                "This view has more than 2^31 pairs of Gaussians and tiles.", _SMALLER
            )
        return int(result or 0)


class _Lease:
    """The views that wait for a backward pass; gives them back if the graph is dropped first."""

    def __init__(self) -> None:
        self.views: list[KernelView] = []

    def __del__(self) -> None:
        for view in self.views:
            view.give_back()


_SMALLER = "Render a smaller image, or fewer or smaller Gaussians."


@dataclass(frozen=True, kw_only=True)
class _Cameras:
    """The cameras and options of `RenderInputs` in the kernels' form."""

    structures: list[bindings.Camera]
    size: tuple[int, int]  # height and width of the window
    sh_degree: int
    raw: bool
    tile_mask: Tensor | None  # kept alive: the structures point to it
    with_depth: Depth
    with_max_weight: bool
    with_weight_sum: bool
    pixel_weights: Tensor | None
    backward_step: BackwardStep | None


def render(inputs: RenderInputs) -> RenderOutput:
    """Render all cameras; see `rasterize`. Raises KernelError."""
    for name, tensor in zip(bindings.Gradients._fields_, inputs.parameters, strict=True):
        if tensor.dtype != torch.float32 or tensor.device.type != "cpu":
            raise KernelError(
                f"rasterize: {name[0]} is {tensor.dtype} on {tensor.device}.",
                "The cpu backend takes float32 tensors on the CPU.",
            )
    if inputs.means.shape[0] > _MOST_GAUSSIANS:
        raise KernelError(
            f"rasterize: {inputs.means.shape[0]} Gaussians are too many.",
            f"Render at most {_MOST_GAUSSIANS} at once.",
        )
    tile_mask = inputs.tile_mask
    tile_mask = None if tile_mask is None else tile_mask.to("cpu", torch.uint8).contiguous()
    left, top, right, bottom = inputs.window
    pixel_weights = inputs.pixel_weights
    if pixel_weights is not None:
        pixel_weights = pixel_weights[:, top:bottom, left:right].contiguous()
    cameras = _Cameras(
        structures=_camera_structures(inputs, tile_mask),
        size=(bottom - top, right - left),
        sh_degree=inputs.sh_degree,
        raw=inputs.raw,
        tile_mask=tile_mask,
        with_depth=inputs.with_depth,
        with_max_weight=inputs.with_max_weight,
        with_weight_sum=inputs.with_weight_sum,
        pixel_weights=pixel_weights,
        backward_step=inputs.backward_step,
    )
    image, alpha, visible, grad2d, depth, max_weight, weight_sum = _Rasterize.apply(  # type: ignore[no-untyped-call]
        cameras, *inputs.parameters
    )
    return RenderOutput(
        image=image.permute(0, 2, 3, 1),  # planar inside: what the kernels and the loss work on
        alpha=alpha,
        visible=visible,
        grad2d=grad2d,
        depth=depth,
        max_weight=max_weight,
        weight_sum=weight_sum,
    )


def _camera_structures(inputs: RenderInputs, tile_mask: Tensor | None) -> list[bindings.Camera]:
    background = inputs.background.tolist()
    structures = []
    cameras = zip(inputs.viewmats.tolist(), inputs.Ks.tolist(), strict=True)
    for c, (view, K) in enumerate(cameras):
        camera = bindings.Camera()
        camera.world_to_camera[:] = [*view[0], *view[1], *view[2]]
        # Python's floats are float64: needed here, as differences of large numbers lose digits
        camera.position[:] = [-sum(view[j][i] * view[j][3] for j in range(3)) for i in range(3)]
        camera.focal_and_centre[:] = [K[0][0], K[1][1], K[0][2], K[1][2]]
        camera.background[:] = background
        camera.blur[:] = inputs.blur
        camera.centre_bounds[:] = inputs.centre_bounds(c)
        camera.min_sigmas = inputs.limits.min_sigmas
        camera.min_transmittance = inputs.limits.min_transmittance
        camera.size[:] = [inputs.width, inputs.height]
        camera.tiles[:] = inputs.tiles
        camera.window[:] = inputs.window
        camera.tile_mask = pointer(tile_mask)
        structures.append(camera)
    return structures


def _gaussians(cameras: _Cameras, parameters: list[Tensor]) -> bindings.Gaussians:
    means, sh = parameters[0], parameters[4]
    return bindings.Gaussians(
        *(pointer(p) for p in parameters),
        means.shape[0],
        sh.shape[1],
        cameras.sh_degree,
        cameras.raw,
    )


class _Rasterize(torch.autograd.Function):
    """(cameras, five parameters) -> planar image (C, 3, H, W), and outputs without gradient."""

    @staticmethod
    def forward(ctx: Any, cameras: _Cameras, *parameters: Tensor) -> tuple[Tensor | None, ...]:
        views, count = len(cameras.structures), parameters[0].shape[0]
        image = torch.empty(views, 3, *cameras.size, dtype=torch.float32)
        alpha = torch.empty(views, *cameras.size, dtype=torch.float32)
        mean = torch.empty_like(alpha) if cameras.with_depth is True else None
        median = torch.zeros_like(alpha) if cameras.with_depth == "median" else None
        visible = torch.zeros(views, count, dtype=torch.bool)
        grad2d = torch.zeros(views, count, dtype=torch.float32)
        max_weight = torch.zeros(count, dtype=torch.float32) if cameras.with_max_weight else None
        weight_sum = torch.zeros(count, dtype=torch.float32) if cameras.with_weight_sum else None
        pixel_weights = cameras.pixel_weights

        ctx.cameras, ctx.lease, ctx.grad2d = cameras, _Lease(), grad2d
        packed = [p.contiguous() for p in parameters]
        for c in range(views):
            view = KernelView.take()
            _prepare(view, cameras, c, packed, visible[c])
            outputs = bindings.Outputs(
                pointer(image[c]),
                pointer(alpha[c]),
                None if mean is None else pointer(mean[c]),
                pointer(max_weight),
                pointer(weight_sum),
                None if pixel_weights is None else pointer(pixel_weights[c]),
            )
            view.call("roigs_render", ctypes.byref(outputs))
            if median is not None:
                view.call("roigs_median_depth", pointer(alpha[c]), pointer(median[c]))
            if any(ctx.needs_input_grad):
                ctx.lease.views.append(view)
            else:
                view.give_back()
        ctx.save_for_backward(image, *parameters)
        depth = median if mean is None else mean
        statistics = (alpha, visible, grad2d, depth, max_weight, weight_sum)
        ctx.mark_non_differentiable(*(t for t in statistics if t is not None))
        ctx.set_materialize_grads(False)
        return image, *statistics

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *output_gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        image_gradient = output_gradients[0]
        image, *parameters = ctx.saved_tensors
        if image_gradient is None:
            return (None,) * (1 + len(parameters))
        image_gradient = image_gradient.to(torch.float32).contiguous()  # planar: no copy
        packed = [p.contiguous() for p in parameters]
        gaussians = _gaussians(ctx.cameras, packed)
        views, ctx.lease.views = ctx.lease.views, []
        if ctx.cameras.backward_step is not None:
            _step(ctx, views, gaussians, image, image_gradient)
            return (None,) * (1 + len(parameters))
        targets = [
            _gradient_target(p, needed)
            for p, needed in zip(parameters, ctx.needs_input_grad[1:], strict=True)
        ]
        gradients = bindings.Gradients(*(pointer(buffer) for buffer, _ in targets))
        for c, image_gradient_c in enumerate(image_gradient):
            if views:
                view = views[c]
            else:  # a second backward through the same graph: the first one gave the views back
                view, visible = KernelView.take(), torch.zeros(len(packed[0]), dtype=torch.bool)
                _prepare(view, ctx.cameras, c, packed, visible)
                again, alpha = torch.empty_like(image[c]), torch.empty_like(image[c, 0])
                outputs = bindings.Outputs(pointer(again), pointer(alpha))
                view.call("roigs_render", ctypes.byref(outputs))
            view.call("roigs_render_backward", pointer(image[c]), pointer(image_gradient_c))
            view.call(
                "roigs_project_backward",
                ctypes.byref(gaussians),
                ctypes.byref(gradients),
                pointer(ctx.grad2d[c]),
            )
            view.give_back()
        return (None, *(buffer if is_fresh else None for buffer, is_fresh in targets))


def _step(
    ctx: Any,
    views: list[KernelView],
    gaussians: bindings.Gaussians,
    image: Tensor,
    image_gradient: Tensor,
) -> None:
    """The backward pass of one camera, with an optimizer step at its end."""
    if not views:
        raise EngineError("rasterize: with a backward step, backward() can be called only once.")
    view = views[0]
    view.call("roigs_render_backward", pointer(image), pointer(image_gradient))
    ctx.cameras.backward_step.take(
        lambda adam: view.call(
            "roigs_project_backward_adam",
            ctypes.byref(gaussians),
            adam,
            pointer(ctx.grad2d),
        )
    )
    view.give_back()


def _prepare(
    view: KernelView, cameras: _Cameras, c: int, parameters: list[Tensor], visible: Tensor
) -> None:
    """Project and bin for camera `c`."""
    gaussians = _gaussians(cameras, parameters)
    view.call(
        "roigs_project",
        ctypes.byref(gaussians),
        ctypes.byref(cameras.structures[c]),
        pointer(visible),
    )
    view.call("roigs_bin")


def _gradient_target(parameter: Tensor, needed: bool) -> tuple[Tensor | None, bool]:
    """The buffer for a parameter's gradient, and whether it is new.

    A dense gradient costs as much for an invisible Gaussian as for a visible one: it is zeroed,
    added to `.grad` and zeroed again by the optimizer. A view shows a small part of the Gaussians,
    so this would be most of a training step. If a leaf already has a `.grad`, rows are added there
    and autograd gets no gradient (so hooks on the leaf do not run).
    """
    if not needed:
        return None, False
    grad = parameter.grad if parameter.is_leaf else None
    if grad is not None and grad.dtype == torch.float32 and grad.is_contiguous():
        return grad, False
    return torch.zeros(parameter.shape, dtype=torch.float32), True
