"""`python benchmarks/schedules`: this folder is the package `schedules`, imported from the one above it."""

import sys
from pathlib import Path

if __name__ == "__main__":
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    from schedules.command import main

    sys.exit(main())
