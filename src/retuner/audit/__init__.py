"""A plant's loops one after the other: which files hold which, their verdicts, where these are kept, and the page."""
