"""Values: scene, boxes, Gaussians, and which box owns which Gaussian."""
