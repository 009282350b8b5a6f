"""Maps the three rooms at the top level to subpackages of retuner; all else stands in pyproject.toml."""

from setuptools import find_packages, setup

ROOMS = ("schedule", "adaptive", "drivers")

package_dir = {"retuner": "src/retuner"}
packages = ["retuner", *(f"retuner.{name}" for name in find_packages("src/retuner"))]
for room in ROOMS:
    package_dir[f"retuner.{room}"] = room
    packages += [f"retuner.{room}", *(f"retuner.{room}.{name}" for name in find_packages(room))]

setup(packages=packages, package_dir=package_dir)
