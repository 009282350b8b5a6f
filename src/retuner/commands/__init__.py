"""The commands of cli.py with their options, one a file; what they do is in work and recorded, loaded when called."""
