"""Makes masks of objects from a user's strokes on one photo or a few (docs/method.md)."""
