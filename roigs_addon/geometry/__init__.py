"""Cameras, poses and boxes in COLMAP's frame and in Blender's. Numpy only, no bpy."""
