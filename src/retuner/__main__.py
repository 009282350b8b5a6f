"""`python -m retuner` is the command `retuner`."""

import sys

from retuner.cli import main

if __name__ == "__main__":
    sys.exit(main())
