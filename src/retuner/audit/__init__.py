"""A plant's loops one after the other: which files hold which, their verdicts, where these are kept, and the page."""

AREA = r"^[A-Za-z_]+-?(\d\d)"  # area in a tag: the first two digits behind its letters, as in FIC46005
