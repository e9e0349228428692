"""Work on a job, whoever asks for it: opened, estimated, computed in batches, kept, written, judged."""
