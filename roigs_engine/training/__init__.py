"""One training stage: photos in, better Gaussians out."""
