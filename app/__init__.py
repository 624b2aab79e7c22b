"""Pharos: a self-hosted, real-time indoor positioning server."""

__version__ = "0.1.0"
