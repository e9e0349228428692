"""Compilation and cache of kernels, and SIMD lanes. Contains no navigation."""
