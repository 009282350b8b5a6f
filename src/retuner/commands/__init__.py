"""The commands of cli.py: what each does, a file each; those on records and models are in recorded/."""
