"""Retuner on plants and loads made by others; docs/developers/plants-of-others.md has the tables."""
