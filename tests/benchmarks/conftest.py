"""The generators of benchmarks/ are a package of the scripts there; the tests import it from the same place."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks"))
