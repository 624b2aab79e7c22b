"""Live state: one device, one bounded mailbox, one fold."""
