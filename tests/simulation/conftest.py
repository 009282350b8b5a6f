"""The simulation lives in benchmarks/bus_simulation; make it importable."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
