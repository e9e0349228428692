"""Steps of any job: open, estimate, compute in batches, keep, write, evaluate."""
