"""The decision: from a response to gains that are proved, or the reason why none (decide.py), and the Retuner."""
