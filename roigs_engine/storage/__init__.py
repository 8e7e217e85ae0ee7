"""Scenes and run folders on anything that fsspec names: copies here, results published whole."""
