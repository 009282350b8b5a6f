"""The report of a designed schedule: one picture that shows why, and a page round it."""
