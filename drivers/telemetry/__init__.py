"""From frames to samples: joining, plausibility, signals of other nodes."""
