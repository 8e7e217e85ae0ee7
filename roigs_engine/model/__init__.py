"""Immutable values: scene, boxes, Gaussians; and which box owns a Gaussian."""
