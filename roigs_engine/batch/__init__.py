"""Many runs at once: divides plans into parts and runs these in parallel."""
