"""Each layer of the protocol held to docs/developers/protocol.md by itself, on both sides of the bus."""
