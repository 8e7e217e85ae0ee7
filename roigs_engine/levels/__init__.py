"""Levels of detail of a result: fewer and fewer Gaussians for each box and the surroundings."""
