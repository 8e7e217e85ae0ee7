"""Gaussians for other programs: moved models made one, and files."""
