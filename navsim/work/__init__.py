"""What is done with a job, by the command line and from Python alike: opened, asked for, computed, written, judged."""
