"""The search for the best places of pseudolites."""
