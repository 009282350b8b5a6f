"""What the tests of trial and undo share: see rig.py."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
