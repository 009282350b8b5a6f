"""What an experiment on demand does unless it is told otherwise."""

DEFAULT_SHARE = 0.05
"""Amplitude as a share of the range of co (step, relay) or pv (setpoint) unless it is given."""
DEFAULT_DEVIATION = 0.2
"""pv may go this share of its range away from rest unless another deviation is given."""
DEFAULT_SAMPLES, REST_WAIT_SAMPLES = 2000, 300
"""Time limits of the excitation and of the wait for rest, in samples, unless they are given."""
