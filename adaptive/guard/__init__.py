"""The guard: proof before change. See proof.py."""
