"""Models in the renderers that they are made for."""
