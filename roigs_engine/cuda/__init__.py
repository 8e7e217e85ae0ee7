"""Support for NVIDIA GPUs: device choice, optional packages, memory, photos on the GPU.

gsplat, fused-ssim and Triton are optional and imported on first use.
"""
