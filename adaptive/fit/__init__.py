"""One fit: the family of processes, the misfit of a record, its slopes, descent and search; in numpy and compiled."""
