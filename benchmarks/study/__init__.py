"""Quality on held-out photos: from scenes and boxes to tables, see benchmarks/README.md."""
