"""Earth and attitude on whole arrays; kernels have their own of one point each (`core.earth`, `core.attitude`)."""
