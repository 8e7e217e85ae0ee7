"""The one engine job at a time: its command, its progress, the use of its results."""
