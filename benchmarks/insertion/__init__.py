"""Objects inserted into the demo's capture, against its true room: `benchmarks.insertion`."""
