"""What people order, and what waits for them: looked at once more before it is written."""
