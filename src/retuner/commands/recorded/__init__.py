"""Commands on records and models: nothing here writes to a controller."""
