"""Whether a device keeps the protocol: an examiner plays host and stranger on its bus and tells what it does wrong."""
