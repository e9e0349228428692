"""Many runs: ensembles and their statistics."""
