"""glTF 2.0 with Khronos's extension KHR_gaussian_splatting, written as one GLB through pygltflib.

A viewer without the extension shows points in the colours of `COLOR_0`. This module reads .glb and
.gltf files, also those of the extension's drafts, and with SPZ inside.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..formats.files import write_bytes
from ..machine import package
from ..model.gaussians import SH_C0
from . import spz
from .arrays import Arrays, joined, logits, opacities, unit_quats
from .gltf_file import BYTE, FLOAT, GltfFile, shown
from .libraries import NotSupportedError, reading, refuse_bomb
from .transform import moved, recoloured

TITLE = "glTF"
NAME = "KHR_gaussian_splatting"
SH_NAMES = [
    f"{NAME}:SH_DEGREE_{degree}_COEF_{k}" for degree in range(4) for k in range(2 * degree + 1)
]
MEANING = {
    "kernel": "ellipse",
    "colorSpace": "srgb_rec709_display",
    "sortingMethod": "cameraDistance",
    "projection": "perspective",
}
POINTS, TRIANGLES, ARRAY_BUFFER = 0, 4, 34962
DRAFTS = ("KHR_spz_gaussian_splats_compression", "KHR_spz_compression")
"""Extensions of primitives that became one of KHR_gaussian_splatting."""
SRGB = ("srgb_rec709_display", "srgb_rec709_scene", "BT.709-sRGB")
LINEAR = ("lin_rec709_display", "lin_rec709_scene", "BT.709-linear")
"""Names of colour spaces: the ratified one, OpenUSD's, and a draft's."""
LUF = np.diag((-1.0, 1.0, -1.0))  # from right, up and back
LEAST = 1e-30  # stands for a size of 0, which has no logarithm


def write(path: Path, arrays: Arrays) -> int:
    """See `FileFormat`."""
    gltf: Any = package("pygltflib", TITLE)
    made = gltf.GLTF2(asset=gltf.Asset(generator="ROI-GS"), extensionsUsed=[NAME], scene=0)
    blob = bytearray()
    attributes = gltf.Attributes()
    for name, values in _columns(arrays).items():
        accessor = gltf.Accessor(
            bufferView=len(made.bufferViews),
            componentType=BYTE if values.dtype == np.uint8 else FLOAT,
            normalized=values.dtype == np.uint8,
            count=len(values),
            type={1: "SCALAR", 3: "VEC3", 4: "VEC4"}[values.size // len(values)],
        )
        if name == "POSITION":
            accessor.min = values.min(axis=0).tolist()
            accessor.max = values.max(axis=0).tolist()
        place = {"buffer": 0, "byteOffset": len(blob), "byteLength": values.nbytes}
        made.bufferViews.append(gltf.BufferView(**place, target=ARRAY_BUFFER))
        blob += values.tobytes()
        setattr(attributes, name, len(made.accessors))
        made.accessors.append(accessor)
    primitive = gltf.Primitive(attributes=attributes, mode=POINTS, extensions={NAME: dict(MEANING)})
    made.meshes.append(gltf.Mesh(primitives=[primitive]))
    made.nodes.append(gltf.Node(mesh=0))
    made.scenes.append(gltf.Scene(nodes=[0]))
    made.buffers.append(gltf.Buffer(byteLength=len(blob)))
    made.set_binary_blob(bytes(blob))
    write_bytes(path, b"".join(made.save_to_bytes()))
    return len(arrays["means"])


def _columns(arrays: Arrays) -> dict[str, NDArray[Any]]:
    """Return attribute -> values, each a multiple of four bytes long."""
    sh = arrays["sh"].astype(np.float32)
    colour = np.column_stack((0.5 + SH_C0 * sh[:, 0], opacities(arrays)))
    columns: dict[str, NDArray[Any]] = {
        "POSITION": arrays["means"].astype(np.float32),
        "COLOR_0": np.clip(np.round(colour * 255), 0, 255).astype(np.uint8),
        f"{NAME}:ROTATION": np.roll(unit_quats(arrays), -1, axis=1),  # xyzw
        f"{NAME}:SCALE": np.exp(arrays["log_scales"]).astype(np.float32),
        f"{NAME}:OPACITY": opacities(arrays),
    }
    for index, name in enumerate(SH_NAMES[: sh.shape[1]]):
        columns[name] = np.ascontiguousarray(sh[:, index])
    return columns


def read(path: Path) -> Arrays:
    """See `FileFormat`. All Gaussians of the scene become one model, placed by their nodes."""
    file = _Splats(path)
    placed = shown(file.record, has_gaussians)
    if not placed:
        raise NotSupportedError(f"glTF without {NAME}")
    own = {id(item): item for _, item in placed}  # many nodes may show the same primitive
    read = {key: file.gaussians(item) for key, item in own.items()}
    refuse_bomb(file.size, sum(map(_bytes, (read[id(item)] for _, item in placed))))
    return joined([moved(read[id(item)], matrix) for matrix, item in placed])


def is_mesh(path: Path) -> bool:
    """Whether a GLB has triangles and no Gaussians."""
    with reading(path, TITLE):
        record = GltfFile(path).record
        every = [item for mesh in record.get("meshes", []) for item in mesh["primitives"]]
        return any(map(has_triangles, every)) and not any(map(has_gaussians, every))


def has_gaussians(primitive: dict[str, Any]) -> bool:
    """Whether a primitive names the extension or one of its drafts."""
    return bool({NAME, *DRAFTS} & primitive.get("extensions", {}).keys())


def has_triangles(primitive: dict[str, Any]) -> bool:
    """Whether a primitive's faces are separate triangles."""
    return bool(primitive.get("mode", TRIANGLES) == TRIANGLES)


def _bytes(arrays: Arrays) -> int:
    return sum(rows.nbytes for rows in arrays.values())


class _Splats(GltfFile):
    """A glTF file with Gaussians."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.packed: dict[tuple[int, bool], Arrays] = {}  # see `_spz`

    def gaussians(self, item: dict[str, Any]) -> Arrays:
        """Return the Gaussians of a primitive, in its own frame."""
        extensions = item["extensions"]
        own = extensions.get(NAME, {})
        inner = {
            **own.get("extensions", {}),
            **{k: extensions[k] for k in DRAFTS if k in extensions},
        }
        packed = next((name for name in inner if "spz" in name.lower()), "")
        for name in inner:  # others may be ignored
            if "compression" in name and name != packed:
                raise NotSupportedError(name)
        arrays = self._spz(inner[packed], own) if packed else self._attributes(item["attributes"])
        space = own.get("colorSpace") or SRGB[0]
        if space in LINEAR:
            return {**arrays, "sh": recoloured(arrays["sh"].astype(np.float32))}
        if space not in SRGB:
            raise NotSupportedError(f"the colour space {space!s:.40}")
        return arrays

    def _attributes(self, at: dict[str, int]) -> Arrays:
        """Return the Gaussians of attributes of the extension, or of drafts without a prefix."""

        def get(*names: str) -> NDArray[np.float32]:
            there = next((name for name in names if name in at), None)
            if there is None:
                raise ValueError(f"no attribute {names[-1]}")
            return self.values(int(at[there]))

        rest = next((k for k, name in enumerate(SH_NAMES[1:]) if name not in at), len(SH_NAMES))
        rest = max(k for k in (0, 3, 8, 15) if k <= rest)
        scales = get(f"{NAME}:SCALE", "_SCALE")
        if not (scales < 0).any():  # drafts until February 2026 had logarithms
            scales = np.log(np.maximum(scales, LEAST))
        # Drafts had colours for the first coefficient, and opacities as their fourth number.
        if SH_NAMES[0] in at:
            base = get(SH_NAMES[0])
        else:
            base = (get("COLOR_0")[:, :3] - np.float32(0.5)) / np.float32(SH_C0)
        if f"{NAME}:OPACITY" in at:
            alpha = get(f"{NAME}:OPACITY")[:, 0]
        else:
            colours = get("COLOR_0")
            alpha = colours[:, 3] if colours.shape[1] == 4 else np.ones(len(colours), np.float32)
        return {
            "means": get("POSITION"),
            "quats": np.roll(get(f"{NAME}:ROTATION", "_ROTATION"), 1, axis=1),
            "log_scales": scales,
            "logit_opacities": logits(alpha),
            "sh": np.stack([base, *(get(name) for name in SH_NAMES[1 : 1 + rest])], axis=1),
        }

    def _spz(self, inside: dict[str, Any], own: dict[str, Any]) -> Arrays:
        """Unpack Gaussians of KHR_gaussian_splatting_compression_spz(_2), to left, up and front.

        Cesium's files of the drafts name no kernel, and already have glTF's axes.
        """
        key = int(inside["bufferView"]), "kernel" in own
        if key in self.packed:  # unpacked for another primitive
            self.count(_bytes(self.packed[key]))
            return self.packed[key]
        raw = bytes(self.view(key[0]))
        arrays, axes = spz.unpacked(raw)
        self.count(_bytes(arrays))
        matrix = np.eye(4)
        matrix[:3, :3] = LUF @ axes if key[1] else axes
        self.packed[key] = moved(arrays, matrix)
        return self.packed[key]
