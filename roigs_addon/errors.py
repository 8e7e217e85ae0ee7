"""The add-on's own kind of error."""

from __future__ import annotations


class AddonError(Exception):
    """Something the user can fix; its text is one line that says how."""
