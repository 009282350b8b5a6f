"""retuner: gain scheduling and on-line adaptive PID."""
