"""How kernels are compiled: decorators, SIMD registers, function pointers, progress, type cache."""
