"""Detects files of Gaussians whose first bytes do not match their name."""

from __future__ import annotations

from pathlib import Path

MAGIC = {
    b"ply\n": ".ply",
    b"ply\r": ".ply",
    b"NGSP": ".spz",
    b"glTF": ".glb",
    b"PXR-USDC": ".usdc",
    b"#usda 1.": ".usda",
}
"""First bytes of files of Gaussians, for formats that have typical ones."""
LFS = b"version https://git-lfs"
"""First bytes of a Git LFS pointer."""
OTHERS = {
    LFS: ("is a pointer of Git LFS", "Fetch the file: git lfs pull."),
    b"<!DOCTYPE": ("is a web page", "Download the file itself, not the page about it."),
    b"<html": ("is a web page", "Download the file itself, not the page about it."),
    b"PK\x03\x04": ("is a ZIP archive", "Unpack it, or rename it if it is a .sog or .usdz."),
    b"\x1f\x8b": ("is packed with gzip", "Unpack it, or rename it if it is an .spz."),
}
ARCHIVES, PACKED = (b"PK\x03\x04", b"\x1f\x8b"), (".sog", ".usdz", ".spz")
FIRST_BYTES = max(map(len, [*MAGIC, *OTHERS]))


def held_instead(path: Path, head: bytes) -> tuple[str, str] | None:
    """The real kind of a file, and advice, if its first bytes `head` contradict its name."""
    if not head:
        return "is empty", "Write or download the file again."
    suffix, head = path.suffix.lower(), head.lstrip()
    for magic, ending in MAGIC.items():
        if head.startswith(magic) and ending != suffix:
            return f"is by its content a file {ending}", f"Rename it to {path.stem}{ending}."
    for magic, words in OTHERS.items():
        if head.startswith(magic) and not (suffix in PACKED and magic in ARCHIVES):
            return words
    return None
