"""Host and device over a simulated bus that loses, doubles, delays, reorders, corrupts and forges, from one seed."""
