"""A gain schedule from ordinary records: curves of the process over a scheduling variable, and the fewest sets."""
