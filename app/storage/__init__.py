"""SQLAlchemy; takes and returns core types, never rows."""
