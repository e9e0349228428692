"""Tables and figures of results: reads results, never runs anything."""
