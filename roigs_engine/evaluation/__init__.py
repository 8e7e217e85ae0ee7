"""Evaluation of models on test photos: scores, tables, images."""
