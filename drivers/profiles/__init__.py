"""Controllers that exist: foreign devices by their DBC or EDS, ready profiles, and virtual ones for benches."""
