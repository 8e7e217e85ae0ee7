"""C++ kernels of the engine: their sources, how they are built, and how they are loaded."""
