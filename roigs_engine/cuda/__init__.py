"""What is done differently on an NVIDIA card; nothing above the rasterizer, loss and Adam asks.

gsplat, fused-ssim and Triton are imported when they are first used, and need not be there.
"""
