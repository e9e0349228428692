"""Kernels on plain float64 arrays: no objects, no units but SI and radians, no input or output."""
