"""A gain table on its way out: to firmware, to a PLC, to other tools, and back into the configuration."""
