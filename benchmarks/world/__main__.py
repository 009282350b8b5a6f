"""`python benchmarks/world`: see command.py."""

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[1])]

if __name__ == "__main__":
    from world.command import main

    sys.exit(main())
