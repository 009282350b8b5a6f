"""`python benchmarks/unlike_ours`: this folder is a package, so the place to import from is the one above it."""

import sys
from pathlib import Path

if __name__ == "__main__":
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    from unlike_ours.run import main

    sys.exit(main())
