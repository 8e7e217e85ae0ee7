"""Many runs at once: their plans cut into parts, and executors that do parts side by side."""
