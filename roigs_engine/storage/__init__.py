"""Scenes and run folders on storage that fsspec supports: local copies, atomic commits."""
