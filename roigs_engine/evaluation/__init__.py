"""Models measured on test photos: scores, tables, pictures."""
