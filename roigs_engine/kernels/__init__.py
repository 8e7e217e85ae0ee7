"""The engine's C++ kernels: sources, build and loading."""
