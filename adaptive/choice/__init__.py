"""Whether a change is worth its risk: what each set of gains is expected to cost. See expected_cost.py."""
