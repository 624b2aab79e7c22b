"""Windowed least squares on beacon levels, static and kinematic, and predicted sigma."""
