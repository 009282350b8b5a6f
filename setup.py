"""Maps the three rooms at the top level to subpackages of retuner; names the compiled engine; all else: pyproject.toml.

The engine is optional: without a compiler everything is installed but it, and numpy computes the fits. It knows only
Python's stable interface, so one wheel serves 3.11 and later. No contraction of a * b + c: the same bits everywhere.
"""

import os
import sys

from setuptools import Extension, find_packages, setup

ROOMS = ("schedule", "adaptive", "drivers")

package_dir = {"retuner": "src/retuner"}
packages = ["retuner", *(f"retuner.{name}" for name in find_packages("src/retuner"))]
for room in ROOMS:
    package_dir[f"retuner.{room}"] = room
    packages += [f"retuner.{room}", *(f"retuner.{room}.{name}" for name in find_packages(room))]

STABLE = "0x030B0000"
ENGINE = ("modes", "lanes", "misfit", "refine", "screen", "search", "valves")
flags = ["/O2", "/std:c11"] if sys.platform == "win32" else ["-std=c11", "-O3", "-ffp-contract=off"]
engine = Extension(
    "retuner.adaptive.fit._engine",
    sources=["adaptive/fit/_engine.c"],
    depends=[f"adaptive/fit/engine_c/{part}.h" for part in ENGINE],
    define_macros=[("Py_LIMITED_API", STABLE)],
    extra_compile_args=flags + os.environ.get("RETUNER_CFLAGS", "").split(),
    py_limited_api=True,
    optional=True,
)

setup(
    packages=packages,
    package_dir=package_dir,
    ext_modules=[engine],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
