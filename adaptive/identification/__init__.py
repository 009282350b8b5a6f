"""The fit: one family of processes and one misfit, shared by identification and by the rivals of diagnosis."""
