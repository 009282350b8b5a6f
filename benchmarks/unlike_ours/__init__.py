"""Loops unlike those of the other benchmarks, streamed through the public interface: see run.py."""
