"""Masks of objects from a person's strokes on one photo or a few (docs/method.md)."""
