"""What the guide's photos gain, with truth: the demo's script renders any photo."""
