"""A CAN bus that survives: opening, faults, the log of its frames."""
