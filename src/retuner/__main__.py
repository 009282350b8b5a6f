"""`python -m retuner` is the command `retuner`."""

import sys

from retuner.cli import main

sys.exit(main())
