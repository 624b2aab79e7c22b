"""Path loss, level smoothing, windows and calibration."""
