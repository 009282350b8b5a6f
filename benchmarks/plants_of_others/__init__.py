"""Retuner on plants and loads made by others; docs/plants-of-others.md has the tables."""
