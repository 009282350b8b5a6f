"""The valve between the output and the process: sticking and play, as an explanation of a record or of a step."""
