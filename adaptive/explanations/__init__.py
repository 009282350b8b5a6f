"""Explanations of a record under loads as plants have them, each with its likelihood, and the odds that follow."""
