"""Simulated plants for the virtual device."""
