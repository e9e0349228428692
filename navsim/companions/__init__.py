"""Systems of the companion papers: scenario section, model, filter, study and report of each side by side."""
