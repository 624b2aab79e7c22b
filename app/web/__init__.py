"""The dashboard: pages and static ES modules that talk only to /v1."""
