"""The CPU backend: the C++ kernels as one differentiable torch function.

Projection, colours, sorting and blending are one function to autograd. Their intermediate results
stay in a `KernelView` on the C++ side, whose memory is reused in each step. kernels/roigs.h has the
interface and the order of calls.
"""

from __future__ import annotations

import ctypes
from functools import partial
from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..errors import EngineError, KernelError
from ..kernels import bindings
from ..kernels.bindings import pointer
from .inputs import RenderInputs, RenderOutput, gradient_targets

_MOST_GAUSSIANS = 2**30  # rows are counted in 32 bits, some beyond the last
_SMALLER = "Render a smaller image, or fewer or smaller Gaussians."


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


def render(inputs: RenderInputs) -> RenderOutput:
    """Render all cameras; see `rasterize`. Raises KernelError."""
    if inputs.means.shape[0] > _MOST_GAUSSIANS:
        raise KernelError(
            f"rasterize: {inputs.means.shape[0]} Gaussians are too many.",
            f"Render at most {_MOST_GAUSSIANS} at once.",
        )
    return RenderOutput.of_planar(*_Rasterize.apply(_Cameras(inputs), *inputs.parameters))  # type: ignore[no-untyped-call]


class _Cameras:
    """The cameras of `RenderInputs` in the kernels' form: one of `structures` for each.

    `size` is height and width of the window; `pixel_weights` (C, H, W) are those in it, None: 1.
    """

    def __init__(self, inputs: RenderInputs) -> None:
        left, top, right, bottom = inputs.window
        self.inputs, self.size = inputs, (bottom - top, right - left)
        self.pixel_weights = None
        if inputs.pixel_weights is not None:
            self.pixel_weights = inputs.pixel_weights[:, top:bottom, left:right].contiguous()
        mask = inputs.tile_mask
        # Kept alive: the structures point to it.
        self._tile_mask = None if mask is None else mask.to("cpu", torch.uint8).contiguous()
        self.structures = []
        background = inputs.background.tolist()
        cameras = zip(inputs.viewmats.tolist(), inputs.Ks.tolist(), strict=True)
        for c, (view, K) in enumerate(cameras):
            camera = bindings.Camera()
            camera.world_to_camera[:] = [*view[0], *view[1], *view[2]]
            # Python's floats are float64: needed here, as differences of large numbers lose digits
            camera.position[:] = [-sum(view[j][i] * view[j][3] for j in range(3)) for i in range(3)]
            camera.focal_and_centre[:] = [K[0][0], K[1][1], K[0][2], K[1][2]]
            camera.background[:] = background
            inputs.fill(camera, c)
            camera.window[:] = inputs.window
            camera.tile_mask = pointer(self._tile_mask)
            self.structures.append(camera)

    def gaussians(self, parameters: list[Tensor]) -> bindings.Gaussians:
        """The kernels' argument of five packed parameters."""
        return bindings.packed_gaussians(parameters, self.inputs.sh_degree, self.inputs.raw)


class _Rasterize(torch.autograd.Function):
    """(cameras, five parameters) -> planar image (C, 3, H, W), and outputs without gradient."""

    @staticmethod
    def forward(ctx: Any, cameras: _Cameras, *parameters: Tensor) -> tuple[Tensor | None, ...]:
        inputs = cameras.inputs
        views, count = len(cameras.structures), parameters[0].shape[0]
        image = torch.empty(views, 3, *cameras.size, dtype=torch.float32)
        alpha = torch.empty(views, *cameras.size, dtype=torch.float32)
        mean = torch.empty_like(alpha) if inputs.with_depth is True else None
        median = torch.zeros_like(alpha) if inputs.with_depth == "median" else None
        visible = torch.zeros(views, count, dtype=torch.bool)
        grad2d = torch.zeros(views, count, dtype=torch.float32)
        max_weight = torch.zeros(count, dtype=torch.float32) if inputs.with_max_weight else None
        weight_sum = torch.zeros(count, dtype=torch.float32) if inputs.with_weight_sum else None
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
        gaussians = ctypes.byref(ctx.cameras.gaussians(packed))
        views, ctx.lease.views = ctx.lease.views, []
        step = ctx.cameras.inputs.backward_step
        if step is not None and not views:
            raise EngineError("rasterize: backward() with a step can be called only once.")
        needed = [step is None and each for each in ctx.needs_input_grad[1:]]
        targets = gradient_targets(parameters, needed)
        gradients = bindings.Gradients(*(pointer(buffer) for buffer, _ in targets))
        for c, gradient in enumerate(image_gradient):
            if views:
                view = views[c]
            else:  # a second backward through the same graph: the first one gave the views back
                view, visible = KernelView.take(), torch.zeros(len(packed[0]), dtype=torch.bool)
                _prepare(view, ctx.cameras, c, packed, visible)
                again, alpha = torch.empty_like(image[c]), torch.empty_like(image[c, 0])
                outputs = bindings.Outputs(pointer(again), pointer(alpha))
                view.call("roigs_render", ctypes.byref(outputs))
            view.call("roigs_render_backward", pointer(image[c]), pointer(gradient))
            grad2d = pointer(ctx.grad2d[c])
            if step is None:
                view.call("roigs_project_backward", gaussians, ctypes.byref(gradients), grad2d)
            else:
                kernel = partial(view.call, "roigs_project_backward_adam", gaussians)
                step.take(lambda adam, kernel=kernel, out=grad2d: kernel(adam, out))
            view.give_back()
        return (None, *(buffer if is_fresh else None for buffer, is_fresh in targets))


def _prepare(
    view: KernelView, cameras: _Cameras, c: int, parameters: list[Tensor], visible: Tensor
) -> None:
    """Project and bin for camera `c`."""
    gaussians, camera = cameras.gaussians(parameters), cameras.structures[c]
    view.call("roigs_project", ctypes.byref(gaussians), ctypes.byref(camera), pointer(visible))
    view.call("roigs_bin")
