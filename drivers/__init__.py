"""The outside: CAN bus, devices, the virtual device with its plant, recorded data, clocks."""
