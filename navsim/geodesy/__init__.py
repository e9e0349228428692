"""The Earth and attitudes: constants and conversions, on whole arrays and in kernels."""
