"""Whether a receiver would notice that something is wrong, and how far its position may be off until it does."""
