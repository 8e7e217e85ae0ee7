"""Compute shaders for every GPU, through wgpu: Vulkan, Metal and DirectX 12."""
