"""Requests: the input of each command, as frozen dataclasses. Standard library only.

Each option is declared once, as a field. Command line, options files, tables of a batch, the panel
in Blender and the reference in docs/options.md follow from the declarations.
"""
