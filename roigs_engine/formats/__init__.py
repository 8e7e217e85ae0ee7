"""Files and lines of text that the engine and the Blender add-on share; numpy only."""
