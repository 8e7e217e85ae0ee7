"""Photos on disk: finding, checking, decoding and caching them; their masks."""
