"""What the tests of trial and undo share: see rig.py."""
