"""Least-squares matching: where photos show a point, found to a few hundredths of a pixel."""
