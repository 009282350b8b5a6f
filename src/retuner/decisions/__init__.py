"""Where decisions are made: here, or in a worker process that nothing waits for."""
