"""Recorded data: trends, bus logs, and samples from them."""
