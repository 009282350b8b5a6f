"""Length of a gain transaction on an idle bus, in controller samples; simulated time, so the same on every machine.

python benchmarks/transaction.py
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from bus_simulation.transaction import transaction

KEY = bytes(range(16))
AIM_SAMPLES = 10


def main() -> int:
    print("polls per sample   code   new set runs after   read back after   frames")
    longest = 0.0
    for polls in (1, 2, 4, 10):
        for key in (None, KEY):
            took = transaction(polls, key)
            longest = max(longest, took.done_samples)
            print(
                f"{polls:>16}   {'yes' if key else 'no':>4}   {took.swap_samples:>10.2f} samples   "
                f"{took.done_samples:>7.2f} samples   {took.frames:>6}"
            )
    print(f"longest: {longest:g} samples; aim: within {AIM_SAMPLES}")
    return int(longest > AIM_SAMPLES)


if __name__ == "__main__":
    sys.exit(main())
