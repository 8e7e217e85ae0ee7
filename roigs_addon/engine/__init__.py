"""Starts the engine, a separate program, and reads its output. Nothing here imports bpy."""
