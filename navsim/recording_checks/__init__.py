"""What is wrong with a recording: units, axes, clocks, fixes that contradict."""
