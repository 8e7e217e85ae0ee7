"""Photos on disk: found, checked, decoded, cached."""
