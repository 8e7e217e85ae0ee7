"""The engine as the add-on sees it: another program. Nothing here imports bpy."""
