"""Photos on disk: finds, checks, decodes and caches them."""
