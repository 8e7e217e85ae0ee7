"""The CPU backend: C++ kernels. kernels/roigs.h documents the interface and the call order.

Intermediate results stay in a `KernelView` on the C++ side; its memory is reused in each step.
"""

from __future__ import annotations

import ctypes
import weakref
from typing import Any, ClassVar

import torch
from torch import Tensor

from ..errors import KernelError
from ..kernels import bindings
from ..kernels.bindings import pointer
from . import kernel_function
from .inputs import RenderInputs, RenderOutput

_MOST_GAUSSIANS = 2**30  # rows are counted in 32 bits, some beyond the last
_SMALLER = "Render a smaller image, or fewer or smaller Gaussians."


class KernelView:
    """Results of a forward pass for its backward pass, on the C++ side.

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
        """Return the view given back last, which may still be in the caches, or a new one."""
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


def render(inputs: RenderInputs) -> RenderOutput:
    """Render all cameras; see `rasterize`. Raises KernelError."""
    if inputs.means.shape[0] > _MOST_GAUSSIANS:
        raise KernelError(
            f"rasterize: {inputs.means.shape[0]} Gaussians are too many.",
            f"Render at most {_MOST_GAUSSIANS} at once.",
        )
    return kernel_function.render(inputs, CameraView)


class CameraView:
    """A `kernel_function.BackendView`; gives its C++ view back when it is garbage-collected."""

    def __init__(
        self, inputs: RenderInputs, c: int, parameters: list[Tensor], visible: Tensor
    ) -> None:
        """Project and bin for camera `c`."""
        view = KernelView.take()
        weakref.finalize(self, view.give_back)
        self._call, mask = view.call, inputs.tile_mask
        # Kept alive, because the structures point to them.
        self._parameters = parameters
        self._tile_mask = None if mask is None else mask.to("cpu", torch.uint8).contiguous()
        self._camera = camera_of(inputs, c)
        self._camera.tile_mask = pointer(self._tile_mask)
        structure = bindings.packed_gaussians(
            parameters, inputs.sh_degree, inputs.raw, inputs.linear_light
        )
        self._gaussians = ctypes.byref(structure)
        self._call("roigs_project", self._gaussians, ctypes.byref(self._camera), pointer(visible))
        self._call("roigs_bin")
        if inputs.with_surface:
            self._call("roigs_project_planes", self._gaussians)

    def draw(self, outputs: kernel_function.Outputs) -> None:
        median = outputs.pop("median", None)
        addresses = {name: pointer(tensor) for name, tensor in outputs.items()}
        self._call("roigs_render", ctypes.byref(bindings.Outputs(**addresses)))
        if median is not None:
            self._call("roigs_median_depth", addresses["alpha"], pointer(median))

    def blend_backward(
        self, drawn: kernel_function.Outputs, gradients: kernel_function.Outputs, grad2d: Tensor
    ) -> None:
        self._grad2d = pointer(grad2d)
        outputs, given = (
            kind(**{name: pointer(tensor) for name, tensor in tensors.items()})
            for kind, tensors in (
                (bindings.Outputs, drawn),
                (bindings.OutputGradients, gradients),
            )
        )
        self._call("roigs_render_backward", ctypes.byref(outputs), ctypes.byref(given))

    def project_backward(self, targets: list[Tensor | None]) -> None:
        gradients = bindings.Gradients(*map(pointer, targets))
        self._call("roigs_project_backward", self._gaussians, ctypes.byref(gradients), self._grad2d)

    def take_step(self, adam: Any) -> int:
        return self._call("roigs_project_backward_adam", self._gaussians, adam, self._grad2d)


def camera_of(inputs: RenderInputs, c: int) -> bindings.Camera:
    """Return camera `c` in the kernels' form, without the mask of its tiles."""
    view, K = inputs.viewmats[c].tolist(), inputs.Ks[c].tolist()
    camera = bindings.Camera()
    camera.world_to_camera[:] = [*view[0], *view[1], *view[2]]
    # Python's floats are float64, needed here because differences of large numbers lose digits
    camera.position[:] = [-sum(view[j][i] * view[j][3] for j in range(3)) for i in range(3)]
    camera.focal_and_centre[:] = [K[0][0], K[1][1], K[0][2], K[1][2]]
    camera.background[:] = inputs.background.tolist()
    inputs.fill(camera, c)
    camera.window[:] = inputs.window
    return camera
