"""Controllers that any DBC describes: numbers in and out of their frames, and a virtual one."""
