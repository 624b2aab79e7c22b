"""The HTTP and WebSocket edge: parse, call, serialise; no decisions."""
