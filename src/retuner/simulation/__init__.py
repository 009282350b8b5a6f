"""A loop in simulated time, and its trend."""
