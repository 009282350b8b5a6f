"""The protocol's frames: layout, coding, check sums, authentication."""
