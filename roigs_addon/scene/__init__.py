"""COLMAP models, boxes and Gaussians as Blender objects."""
