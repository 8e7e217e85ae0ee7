"""Support for NVIDIA GPUs: device choice, our kernels, memory, photos on the GPU."""
