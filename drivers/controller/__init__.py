"""The controller behind the bus: the virtual device with its firmware's memory and lease."""
