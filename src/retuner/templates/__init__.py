"""Files that the commands write for a user."""
