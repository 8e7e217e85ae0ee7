"""Models for other programs: file formats and transforms."""
