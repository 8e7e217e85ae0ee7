"""Optional packages that read and write files, imported when they are used."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from ..errors import EngineError

EXTRA = "formats"
"""The extra of pyproject.toml that installs all of them."""


def package(module: str, name: str, purpose: str) -> Any:
    """A module of an optional package.

    Args:
        module: to import.
        name: of the package, as pip knows it.
        purpose: begins the error's sentence, such as "SPZ".

    Raises:
        EngineError: it is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise EngineError(
            f"{purpose} needs {name}, which is not installed ({error}).",
            f"Install {name}, or all of the extra '{EXTRA}'.",
        ) from error
