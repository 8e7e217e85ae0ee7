"""Levels of detail of a result: ladders of ever fewer Gaussians for each box and what is around."""
