"""The work behind the commands of cli.py, one a file, imported when called."""
