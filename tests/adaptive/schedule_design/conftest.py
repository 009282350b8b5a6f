"""Makes schedule_cases.py importable from the tests beside it."""
