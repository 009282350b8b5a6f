"""A world with real loads: see command.py."""
