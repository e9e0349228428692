"""How kernels are compiled, kept and found again; numbers that are SIMD registers. Nothing of navigation."""
