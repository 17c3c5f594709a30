"""The same simulator as Warp kernels, in double precision, for CPU and CUDA."""
