"""Runs one engine job at a time: its command, its progress, its results."""
