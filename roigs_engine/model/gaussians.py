"""The model of Gaussians: five tensors with one row per Gaussian."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor
from torch.nn import functional

from ..errors import ConfigError
from ..formats.ply_rows import Check, nothing
from ..formats.splat_ply import Float32, Floats, Made, made_of, read_ply, write_ply
from ..formats.targets import PLAIN, Target
from .local_frame import LocalFrame
from .roi import OrientedBox
from .scene import Float64

SH_C0 = 0.28209479177387814  # the SH basis function of degree 0, 1 / (2 sqrt(pi))
NAMES = ("means", "quats", "log_scales", "logit_opacities", "sh")


@dataclass(frozen=True, kw_only=True, eq=False)
class Gaussians:
    """N Gaussians in their stored (trained) form.

    Attributes:
        means: (N, 3) world positions.
        quats: (N, 4) rotations wxyz, not necessarily normalised.
        log_scales: (N, 3) natural logarithms of the standard deviations, world units.
        logit_opacities: (N,).
        sh: (N, K, 3) SH coefficients of colour minus 0.5, K = 1, 4, 9 or 16.
        target: the renderers that they were trained for. A model looks right only in these.
        photo_focal: focal length of the training photos, pixels. Pictures with another focal length
            have pixels of another size (`rasterize.view`). None: unknown.
    """

    means: Tensor
    quats: Tensor
    log_scales: Tensor
    logit_opacities: Tensor
    sh: Tensor
    target: Target = PLAIN
    photo_focal: float | None = None

    def __len__(self) -> int:
        return self.means.shape[0]

    @property
    def antialiased(self) -> bool:
        """Whether they are drawn with anti-aliasing (`rasterize`)."""
        return self.target.antialiased

    def tensors(self) -> dict[str, Tensor]:
        """The five tensors by name, not copied."""
        return {name: getattr(self, name) for name in NAMES}

    def with_tensors(self, tensors: Mapping[str, Tensor]) -> Gaussians:
        """The model with these tensors instead of its own; it shares the others."""
        return Gaussians(
            **{**self.tensors(), **tensors}, target=self.target, photo_focal=self.photo_focal
        )

    def rows(self, index: Tensor) -> Gaussians:
        """A copy of the Gaussians selected by a boolean mask (N,) or by row numbers."""
        rows = index.nonzero()[:, 0] if index.dtype == torch.bool else index
        # index_select copies whole rows; t[rows] copies single elements and takes 7 times as long
        # for sh
        return self.with_tensors(
            {name: t.detach().index_select(0, rows) for name, t in self.tensors().items()}
        )

    def detached(self) -> Gaussians:
        """A copy that shares no memory and requires no gradient."""
        return self.with_tensors({n: t.detach().clone() for n, t in self.tensors().items()})

    def in_box(self, roi: OrientedBox) -> Tensor:
        """(N,) bool: whether the Gaussian's centre lies inside the box."""
        centres = self.means.detach().cpu().double().numpy()
        return torch.from_numpy(roi.contains(centres))

    def to(self, device: torch.device) -> Gaussians:
        """The Gaussians on a device; tensors that are already there are shared."""
        return self.with_tensors({name: t.to(device) for name, t in self.tensors().items()})

    @staticmethod
    def concatenate(parts: list[Gaussians]) -> Gaussians:
        """Join the parts into one model, in their order; missing SH bands become zeros.

        The result has the shortest focal length of photos. ConfigError: the parts are made for
        different targets.
        """
        titles = list(dict.fromkeys(part.target.title for part in parts))
        if len(titles) > 1:
            raise ConfigError(
                f"Some of the models are made for {titles[0]}, others for {titles[1]}.",
                "Use models made for the same renderer.",
            )
        columns = {name: [getattr(p, name).detach() for p in parts] for name in NAMES}
        bands = max(sh.shape[1] for sh in columns["sh"])
        columns["sh"] = [
            sh if sh.shape[1] == bands else functional.pad(sh, (0, 0, 0, bands - sh.shape[1]))
            for sh in columns["sh"]
        ]
        tensors = {name: torch.cat(column) for name, column in columns.items()}
        known = [part.photo_focal for part in parts if part.photo_focal is not None]
        focal = min(known, default=None)  # the widest blur, as in `render_instances`
        return Gaussians(**tensors, target=parts[0].target, photo_focal=focal)

    @classmethod
    def from_points(
        cls,
        points: Float64,  # (P, 3)
        colors: NDArray[np.uint8],  # (P, 3) uint8
    ) -> Gaussians:
        """The start of training: one Gaussian per sparse point (3DGS, Kerbl et al. 2023, sec. 5.1).

        Isotropic; standard deviation = root mean squared distance to the 3 nearest points; opacity
        0.1; the point's colour in SH degree 0.
        """
        count = len(points)
        neighbours = min(4, count)
        distances = cKDTree(points).query(points, k=neighbours)[0].reshape(count, neighbours)
        spacing = np.ones(count)
        if neighbours > 1:
            spacing = np.sqrt((distances[:, 1:] ** 2).mean(axis=1))
        log_scales = np.log(np.maximum(spacing, 1e-7))
        sh = np.zeros((count, 16, 3), dtype=np.float32)
        sh[:, 0] = (colors / 255.0 - 0.5) / SH_C0
        quats = np.zeros((count, 4), dtype=np.float32)
        quats[:, 0] = 1.0
        return cls.from_arrays(
            {
                "means": points.astype(np.float32),
                "quats": quats,
                "log_scales": np.repeat(log_scales[:, None], 3, axis=1).astype(np.float32),
                "logit_opacities": np.full(count, np.log(0.1 / 0.9), dtype=np.float32),
                "sh": sh,
            }
        )

    @classmethod
    def from_arrays(
        cls,
        arrays: Mapping[str, Floats],
        *,
        target: Target = PLAIN,
        photo_focal: float | None = None,
    ) -> Gaussians:
        """Create a model from arrays, named as the attributes."""
        tensors = {
            name: torch.from_numpy(np.ascontiguousarray(arrays[name], dtype=np.float32))
            for name in NAMES
        }
        return cls(**tensors, target=target, photo_focal=photo_focal)

    def save_ply(
        self,
        path: Path,
        frame: LocalFrame | None = None,
        more: Mapping[str, Float32] | None = None,
    ) -> None:
        """Write a standard 3DGS PLY in the world frame, atomically.

        `frame`: the frame of these Gaussians; `more`: as for `write_ply`.
        """
        arrays = self.arrays(frame)
        write_ply(path, arrays, self.target, photo_focal=self.photo_focal, more=more)

    def arrays(self, frame: LocalFrame | None = None) -> dict[str, Floats]:
        """The five arrays by name, as in a PLY, in the world; `frame`: of these Gaussians."""
        arrays: dict[str, Floats] = {
            name: t.detach().cpu().numpy() for name, t in self.tensors().items()
        }
        return arrays if frame is None else _to_world(arrays, frame)

    @classmethod
    def load_ply(
        cls, path: Path, frame: LocalFrame | None = None, check: Check = nothing
    ) -> Gaussians:
        """Read a 3DGS PLY, into a frame if one is given; RunFolderError if the file is not one.

        `check` is called while reading.
        """
        arrays = read_ply(path, check)
        local = arrays if frame is None else _to_local(arrays, frame)
        return cls.from_arrays(local, **made_of(path))

    @classmethod
    def load_framed(
        cls, path: Path, check: Check = nothing, *, scaled: bool = True
    ) -> tuple[Gaussians, LocalFrame]:
        """Read a 3DGS PLY as `load_ply`, in a frame of its own (`framed`); returns both."""
        return cls.framed(read_ply(path, check), scaled=scaled, **made_of(path))

    @classmethod
    def framed(
        cls,
        arrays: Mapping[str, Floats],
        *,
        scaled: bool = True,
        target: Target = PLAIN,
        photo_focal: float | None = None,
    ) -> tuple[Gaussians, LocalFrame]:
        """Convert a PLY's arrays to a model in a frame of its own; returns both.

        Without `scaled`, the frame is the world if the positions are float32; otherwise it has the
        world's unit. So all values stay the same bit for bit.
        """
        made: Made = {"target": target, "photo_focal": photo_focal}
        if not scaled and arrays["means"].dtype == np.float32:
            return cls.from_arrays(arrays, **made), LocalFrame.world()
        frame = LocalFrame.of_centres(arrays["means"].astype(np.float64))
        if not scaled:
            frame = replace(frame, scale=1.0)
        return cls.from_arrays(_to_local(arrays, frame), **made), frame


def _to_world(arrays: Mapping[str, Floats], frame: LocalFrame) -> dict[str, Floats]:
    """Convert arrays from a frame to the world; far centres become float64."""
    if frame.is_world:
        return dict(arrays)
    near = not frame.origin.any()
    with np.errstate(all="ignore"):  # numbers too large for float32 become Inf
        means = arrays["means"].astype(np.float64) / frame.scale + frame.origin
        stored = means.astype(np.float32) if near else means
    log_scales = arrays["log_scales"] - np.float32(np.log(frame.scale))
    return {**arrays, "means": stored, "log_scales": log_scales}


def _to_local(arrays: Mapping[str, Floats], frame: LocalFrame) -> dict[str, Floats]:
    """The inverse of `_to_world`."""
    if frame.is_world:
        return dict(arrays)
    with np.errstate(all="ignore"):  # numbers too large for float32 become Inf; these are not drawn
        means = frame.points(arrays["means"].astype(np.float64)).astype(np.float32)
    log_scales = arrays["log_scales"] + np.float32(np.log(frame.scale))
    return {**arrays, "means": means, "log_scales": log_scales}
