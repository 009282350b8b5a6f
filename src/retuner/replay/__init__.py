"""A session or a log decided again."""
