"""Which variables a schedule follows, which sets it has, how it moves, and what to record next."""
