"""Photos on disk: found, checked, decoded and cached; their masks."""
