"""Loops on one plant: what each output does to each process value, and what a change of one loop means for all."""
