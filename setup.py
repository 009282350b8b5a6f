"""Maps the three rooms at the top level to subpackages of retuner; names the compiled engine; all else: pyproject.toml.

An editable install links the rooms into src/retuner (the links are git-ignored) and so needs one path and no import
hook: type checkers, which run no hook, find what Python finds. Where no link can be made the hook does it, untyped.

The engine is optional: without a compiler everything is installed but it, and numpy computes the fits. It knows only
Python's stable interface, so one wheel serves 3.11 and later. No contraction of a * b + c: the same bits everywhere.
"""

import os
import sys
from pathlib import Path

from setuptools import Extension, find_packages, setup

ROOMS = ("schedule", "adaptive", "drivers")
FOLDERS_OF_DATA = ["retuner.drivers.firmware", "retuner.serve.static"]  # no code in them; setuptools wants them named


def linked() -> bool:
    """Lay the links; whether all of them are there."""
    for room in ROOMS:
        link = Path("src", "retuner", room)
        try:
            if not link.is_symlink():
                link.symlink_to(Path("..", "..", room), target_is_directory=True)
        except OSError:  # Windows without the right to make links
            return False
    return all(Path("src", "retuner", room, "__init__.py").exists() for room in ROOMS)


if "editable_wheel" in sys.argv and linked():
    package_dir, packages = {"": "src"}, find_packages("src")
else:
    package_dir = {"retuner": "src/retuner"}
    apart = [f"{room}{below}" for room in ROOMS for below in ("", ".*")]
    packages = ["retuner", *(f"retuner.{name}" for name in find_packages("src/retuner", exclude=apart))]
    for room in ROOMS:
        package_dir[f"retuner.{room}"] = room
        packages += [f"retuner.{room}", *(f"retuner.{room}.{name}" for name in find_packages(room))]
packages += FOLDERS_OF_DATA

STABLE = "0x030B0000"
flags = ["/O2", "/std:c11"] if sys.platform == "win32" else ["-std=c11", "-O3", "-ffp-contract=off"]
engine = Extension(
    "retuner.adaptive.fit._engine",
    sources=["adaptive/fit/_engine.c"],
    depends=sorted(str(part) for part in Path("adaptive/fit/engine_c").glob("*.h")),
    define_macros=[("Py_LIMITED_API", STABLE)],
    extra_compile_args=flags + os.environ.get("RETUNER_CFLAGS", "").split(),
    py_limited_api=True,
    optional=True,
)

without = bool(os.environ.get("RETUNER_WITHOUT_ENGINE"))  # a wheel for every machine; numpy computes the fits

man = [("share/man/man1", ["docs/retuner.1"])]  # made by scripts/document_manual.py

setup(
    packages=packages,
    package_dir=package_dir,
    data_files=man,
    ext_modules=[] if without else [engine],
    options={} if without else {"bdist_wheel": {"py_limited_api": "cp311"}},
)
