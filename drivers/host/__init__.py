"""The host's side of the protocol: requests, reading back, two-phase writes, the lease."""
