"""The one kind of error that the add-on raises on purpose."""

from __future__ import annotations


class AddonError(Exception):
    """Something the user can fix; its text is one line that says how."""
