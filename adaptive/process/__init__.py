"""Process models: what the loop controls, with its dead time, and how models are reduced and converted."""
