"""What a receiver and a filter believe and do."""
