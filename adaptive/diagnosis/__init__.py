"""Causes of a loop's behaviour, one detector a file."""
