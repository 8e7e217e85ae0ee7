"""Geometry of cameras, boxes and Gaussians, in COLMAP's and Blender's frames. No bpy."""
