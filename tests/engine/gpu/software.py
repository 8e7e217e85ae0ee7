"""A processor that plays a GPU: Mesa's software Vulkan, where it is installed.

The environment variable ROIGS_TEST_GPU names another GPU to test.
"""

from __future__ import annotations

import os

import pytest

from roigs_engine.errors import KernelError
from roigs_engine.gpu.adapters import Adapter, adapters, find


def software_adapter() -> Adapter:
    """It, or the test is skipped."""
    if name := os.environ.get("ROIGS_TEST_GPU"):
        return find(name)
    try:
        found = [each for each in adapters() if each.is_software]
    except KernelError as error:
        pytest.skip(error.message)
    if not found:
        pytest.skip("no software Vulkan here: install Debian's mesa-vulkan-drivers")
    return found[0]
