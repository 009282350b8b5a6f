"""Loops drawn at random with their truth, for measuring identification and diagnosis: pure functions of a seed."""
