"""Many runs at once: plans are divided into parts, which executors do in parallel."""
