"""Models for other programs: file formats, and models under transforms."""
