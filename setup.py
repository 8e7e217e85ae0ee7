"""Compiles the kernels when the package is built, and puts them into its wheel.

All metadata is in pyproject.toml. ROIGS_BUILD_TARGET names another platform to build the wheel for
(a key of PLATFORMS in roigs_engine/kernels/build.py), for instance windows-x64 on Linux.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import sys
from pathlib import Path
from types import ModuleType

from setuptools import Command, Distribution, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build import build

ROOT = Path(__file__).resolve().parent
KERNELS = Path("roigs_engine", "kernels")
TARGET = os.environ.get("ROIGS_BUILD_TARGET", "native")

# The oldest system that the bundled compiler's libraries run on.
WHEEL_PLATFORMS = {
    "linux-x64": "manylinux_2_17_x86_64",
    "linux-arm64": "manylinux_2_17_aarch64",
    "windows-x64": "win_amd64",
    "macos-x64": "macosx_11_0_x86_64",
    "macos-arm64": "macosx_11_0_arm64",
}


def kernel_builder() -> ModuleType:
    """roigs_engine/kernels/build.py, without importing the package and what it depends on."""
    name = "roigs_kernel_builder"
    spec = importlib.util.spec_from_file_location(name, ROOT / KERNELS / "build.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


class BuildKernels(Command):
    """Compiles into the build folder; for an editable install, into the source tree."""

    description = "compile the C++ kernels"
    user_options: list[tuple[str, str | None, str]] = []  # noqa: RUF012 - as setuptools wants it
    editable_mode = False
    build_lib: str | None = None

    def initialize_options(self) -> None:
        self.build_lib = None

    def finalize_options(self) -> None:
        self.set_undefined_options("build_py", ("build_lib", "build_lib"))

    def run(self) -> None:
        builder = kernel_builder()
        if not self.editable_mode:  # another platform's from an earlier build would go along
            shutil.rmtree(self._folder(), ignore_errors=True)
        try:
            builder.build(self._folder(), target=TARGET)
        except builder.BuildError as error:
            raise SystemExit(f"error: {error}") from error

    def get_source_files(self) -> list[str]:
        return [str(path.relative_to(ROOT)) for path in sorted((ROOT / KERNELS).glob("*.[ch]*"))]

    def get_outputs(self) -> list[str]:
        if self.editable_mode:
            return []
        return [str(path) for path in self._folder().rglob("roigs_*")]

    def get_output_mapping(self) -> dict[str, str]:
        return {}

    def _folder(self) -> Path:
        root = ROOT if self.editable_mode else Path(str(self.build_lib))
        return root / KERNELS / "lib"


class BuildWithKernels(build):
    sub_commands = [*build.sub_commands, ("build_kernels", None)]  # noqa: RUF012


class PlatformWheel(bdist_wheel):
    """One wheel per platform that serves every Python: the kernels are loaded by ctypes."""

    def get_tag(self) -> tuple[str, str, str]:
        builder = kernel_builder()
        target = builder.native_platform() if TARGET == "native" else TARGET
        _, _, platform = super().get_tag()
        if importlib.util.find_spec("ziglang") is not None:
            platform = WHEEL_PLATFORMS[target]
        return "py3", "none", platform


class BinaryDistribution(Distribution):
    def has_ext_modules(self) -> bool:
        return True


setup(
    distclass=BinaryDistribution,
    cmdclass={
        "build": BuildWithKernels,
        "build_kernels": BuildKernels,
        "bdist_wheel": PlatformWheel,
    },
)
