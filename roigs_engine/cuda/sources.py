"""The sources of the CUDA kernels: their own, and the headers they share with the C++ kernels.

A compiler gets them as one program and headers by name, so that nothing has to be on disk: NVRTC
has no standard library, and `simd.h` is another one here, with one Gaussian per thread.
"""

from __future__ import annotations

import functools
import hashlib
from pathlib import Path

from ..kernels.build import SOURCE_FOLDER as SHARED_FOLDER

FOLDER = Path(__file__).parent / "kernels"
PROGRAMS = ("project.cu", "blend.cu", "weigh.cu", "gradient.cu", "backward.cu", "loss.cu")
SHARED = ("constants.h", "types.h", "sh.h", "ellipses.h", "geometry.h", "geometry_gradient.h")
KERNELS = (
    *("place_camera", "project", "list_tiles", "begin_tiles", "begin_groups"),
    *("blend", "median_depth", "weigh", "fold_weights", "gradient"),
    *("project_backward", "project_backward_adam", "loss", "loss_gradient", "loss_terms"),
)
"""The names of all kernels."""

_INTEGERS = """#pragma once
typedef signed char int8_t;
typedef unsigned char uint8_t;
typedef short int16_t;
typedef int int32_t;
typedef unsigned int uint32_t;
typedef long long int64_t;
typedef unsigned long long uint64_t;
"""


def program() -> str:
    """The program: all kernels."""
    return "".join(f'#include "{name}"\n' for name in PROGRAMS)


@functools.cache
def headers() -> dict[str, str]:
    """Name -> text of all that `program` includes, itself or further down."""
    found = {path.name: _text(path) for path in sorted(FOLDER.iterdir()) if path.suffix != ".md"}
    found |= {name: _text(SHARED_FOLDER / name) for name in SHARED}
    scalar = '#pragma once\n#include "scalar.h"\n'
    return found | {"simd.h": scalar, "simd_rows.h": scalar, "cstdint": _INTEGERS}


@functools.cache
def source_key() -> str:
    """A hash of the sources."""
    digest = hashlib.sha256(program().encode())
    for name, text in headers().items():
        digest.update(f"{name}\0{text}\0".encode())
    return digest.hexdigest()[:16]


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")
