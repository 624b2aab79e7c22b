"""The positioning engine: pure NumPy and numba, no clock, no I/O, no hidden state."""
