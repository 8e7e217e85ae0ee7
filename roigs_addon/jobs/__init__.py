"""The one engine job that runs at a time: what to run, how it is going, what becomes of it."""
