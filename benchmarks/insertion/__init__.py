"""Things put into the demo's capture against its true room: `python -m benchmarks.insertion`."""
