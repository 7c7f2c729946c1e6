"""Settings chosen from data."""
