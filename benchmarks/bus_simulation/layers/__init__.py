"""Each layer of the protocol held to docs/protocol.md by itself, on both sides of the bus."""
