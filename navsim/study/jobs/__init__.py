"""The jobs (`study.job`) of landings, their studies, recorded flights and the paper's tables; those of the companion
systems are in `companions.jobs`."""
