"""For all tests: one thread for linear algebra.

And for hypothesis: no deadline (the machines are shared and noisy), and in CI the same examples every time.
"""

import os

for _library in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_library, "1")  # thousands of small matrices: threads only get in each other's way

from hypothesis import settings  # noqa: E402  the threads are counted when numpy is loaded

settings.register_profile("here", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "here")
