"""Cached data for panels and buttons; a sidebar is drawn many times a second."""
