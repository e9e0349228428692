"""Every combination of listed settings."""
