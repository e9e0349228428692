"""Statistics on whole arrays."""
