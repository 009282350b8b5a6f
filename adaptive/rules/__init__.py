"""Tuning rules, one a file: plain functions from a process model or a response to gains."""
