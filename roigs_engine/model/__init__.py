"""The model as data: scene, boxes, Gaussians, and who owns what."""
