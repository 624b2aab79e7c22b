"""Filters that join absolute fixes and dead reckoning."""
