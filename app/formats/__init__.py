"""Parsers of survey and trace files into core types: pure, streaming, bounded."""
