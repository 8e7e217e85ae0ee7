"""The compiled backends as one differentiable torch function.

Projection, colours, sorting and blending are one function for autograd. Data of the forward pass
for the backward pass stay in a `BackendView`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..errors import EngineError
from .inputs import RenderInputs, RenderOutput, Surface

Outputs = dict[str, Tensor | None]
"""Tensors to draw into: the fields of `bindings.Outputs` for one camera, and `median`, a depth."""


class BackendView(Protocol):
    """The forward pass of one camera, projected and binned, with a backend's kernels."""

    def draw(self, outputs: Outputs) -> None:
        """Blend into the tensors, which have the size of the window; depths are zeros before."""

    def blend_backward(self, drawn: Outputs, gradients: Outputs, grad2d: Tensor) -> None:
        """Begin the backward pass, once, and write `grad2d` (N,).

        `drawn` has image, alpha and surface; `gradients` has the fields of
        `bindings.OutputGradients`.
        """

    def project_backward(self, targets: list[Tensor | None]) -> None:
        """End the backward pass: add the five parameters' gradients to `targets`, unless None."""

    def take_step(self, adam: Any) -> int | Tensor:
        """End the backward pass with an optimizer's step, see `BackwardStep`."""


Begin = Callable[[RenderInputs, int, list[Tensor], Tensor], BackendView]
"""Function of inputs, camera, contiguous parameters, and (N,) bool for the visible Gaussians."""


def render(inputs: RenderInputs, begin: Begin) -> RenderOutput:
    """Render all cameras; see `rasterize`. Raises KernelError."""
    outputs = _KernelFunction.apply(begin, inputs, *inputs.parameters)  # type: ignore[no-untyped-call]
    image, alpha, planes, visible, grad2d, depth, max_weight, weight_sum = outputs
    return RenderOutput(
        image=image.permute(0, 2, 3, 1),  # planar until here
        alpha=alpha,
        visible=visible,
        grad2d=grad2d,
        depth=depth,
        max_weight=max_weight,
        weight_sum=weight_sum,
        surface=None if planes is None else Surface.of(planes, alpha),
    )


class _KernelFunction(torch.autograd.Function):
    """Five parameters -> planar image (C, 3, H, W), alpha, planes, and outputs without gradient.

    The planes (`Surface.of`) and alpha have gradients where there is a surface.
    """

    @staticmethod
    def forward(
        ctx: Any, begin: Begin, inputs: RenderInputs, *parameters: Tensor
    ) -> tuple[Tensor | None, ...]:
        views, outputs = _drawn(begin, inputs, parameters)
        image, alpha, planes, *statistics = outputs
        ctx.begin, ctx.inputs, ctx.views, ctx.grad2d = begin, inputs, views, statistics[1]
        ctx.save_for_backward(
            image, *((None, None) if planes is None else (alpha, planes)), *parameters
        )
        others = [alpha, *statistics] if planes is None else statistics
        ctx.mark_non_differentiable(*(t for t in others if t is not None))
        ctx.set_materialize_grads(False)
        return outputs

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *output_gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        image, alpha, planes, *parameters = ctx.saved_tensors
        of_image, *of_surface = output_gradients[:3]
        if all(each is None for each in (of_image, *of_surface)):
            return (None,) * (2 + len(parameters))
        step, views, ctx.views = ctx.inputs.backward_step, ctx.views, None
        if views is None:  # a second backward through the same graph: the views are gone
            if step is not None:
                raise EngineError("rasterize: backward() with a step can be called only once.")
            views, _ = _drawn(ctx.begin, ctx.inputs, parameters)
        if of_image is None:
            of_image = torch.zeros_like(image)
        of_image = of_image.to(torch.float32).contiguous()  # planar: no copy
        surface = _surface_gradient(planes, *of_surface)
        needed = [step is None and each for each in ctx.needs_input_grad[2:]]
        targets = [
            torch.zeros(p.shape, dtype=torch.float32, device=p.device) if each else None
            for p, each in zip(parameters, needed, strict=True)
        ]
        for c, view in enumerate(views):
            drawn: Outputs = {"image": image[c]}
            gradients: Outputs = {"image": of_image[c]}
            if surface is not None:
                drawn |= {"alpha": alpha[c], "surface": planes[c]}
                gradients["surface"] = surface[c]
            view.blend_backward(drawn, gradients, ctx.grad2d[c])
            if step is None:
                view.project_backward(targets)
            else:
                step.take(view.take_step)
        return (None, None, *targets)


def _surface_gradient(
    planes: Tensor | None, of_alpha: Tensor | None, of_planes: Tensor | None
) -> Tensor | None:
    """(C, 6, H, W) dL / d(alpha), dL / d(planes); None without gradients."""
    if planes is None or (of_alpha is None and of_planes is None):
        return None
    cameras, count, height, width = planes.shape
    gradient = planes.new_zeros(cameras, 1 + count, height, width)
    if of_alpha is not None:
        gradient[:, 0] = of_alpha
    if of_planes is not None:
        gradient[:, 1:] = of_planes
    return gradient


def _drawn(
    begin: Begin, inputs: RenderInputs, parameters: tuple[Tensor, ...] | list[Tensor]
) -> tuple[list[BackendView], tuple[Tensor | None, ...]]:
    """Draw; return the views, if there may be a backward pass, and `_KernelFunction`'s outputs."""
    cameras, count, device = len(inputs.viewmats), len(parameters[0]), parameters[0].device
    left, top, right, bottom = inputs.window
    height, width = bottom - top, right - left
    image = torch.empty(cameras, 3, height, width, dtype=torch.float32, device=device)
    alpha = image.new_empty(cameras, height, width)
    depth = torch.zeros_like(alpha) if inputs.with_depth else None
    planes = image.new_zeros(cameras, 5, height, width) if inputs.with_surface else None
    visible = torch.zeros(cameras, count, dtype=torch.bool, device=device)
    grad2d = image.new_zeros(cameras, count)
    max_weight = image.new_zeros(count) if inputs.with_max_weight else None
    weight_sum = image.new_zeros(count) if inputs.with_weight_sum else None
    weights = inputs.pixel_weights
    if weights is not None:
        weights = weights[:, top:bottom, left:right].contiguous()
    packed, views = [p.detach().contiguous() for p in parameters], []
    for c in range(cameras):
        view = begin(inputs, c, packed, visible[c])
        outputs: Outputs = {
            "image": image[c],
            "alpha": alpha[c],
            "max_weight": max_weight,
            "weight_sum": weight_sum,
            "pixel_weights": None if weights is None else weights[c],
        }
        if planes is not None:
            outputs["surface"] = planes[c]
        if depth is not None:
            outputs["median" if inputs.with_depth == "median" else "depth"] = depth[c]
        view.draw(outputs)
        if inputs.is_trained:
            views.append(view)
    return views, (image, alpha, planes, visible, grad2d, depth, max_weight, weight_sum)
