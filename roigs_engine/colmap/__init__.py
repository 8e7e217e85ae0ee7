"""A COLMAP project read into a scene, inspected and exported."""
