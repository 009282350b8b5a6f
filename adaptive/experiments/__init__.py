"""Experiments on a process: what their records say, and the states that an experiment on demand goes through."""
