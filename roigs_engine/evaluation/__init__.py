"""Evaluates models on test photos: scores, tables, images."""
