"""Steps, step length, heading, motion mode and dead reckoning."""
