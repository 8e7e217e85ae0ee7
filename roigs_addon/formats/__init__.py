"""The files and lines that the add-on shares with the engine (docs/files.md). Numpy only, no bpy.

One file for each format, so that a rule is written down once.
"""
