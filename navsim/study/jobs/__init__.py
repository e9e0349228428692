"""The job of every kind of file (`study.job`), and that of the paper's tables."""
