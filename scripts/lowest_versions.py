"""Run the demo and a fast part of the tests with the lowest versions that pyproject.toml allows.

    python scripts/lowest_versions.py       about half a minute of CPU, after the environment is made

The environment, .venv-lowest, is made anew where the versions have changed since. Every package that pyproject.toml
names for users (extras among them) or for the tests has its lowest version; what those need in turn is the newest.
The extra fmu is left out: FMPy itself asks for a newer numpy than the lowest that the rest takes.
"""

import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import venv
from pathlib import Path

from release import NOT_SOURCE

ROOT = Path(__file__).resolve().parent.parent
ENVIRONMENT = ROOT / ".venv-lowest"
PYTHON = ENVIRONMENT / "bin" / "python"
STAMP = ENVIRONMENT / "versions.txt"
TESTS = (
    "tests/schedule/test_pid.py",
    "tests/adaptive/rules/test_published.py",
    "tests/adaptive/test_region_model.py",
    "tests/drivers/test_recording.py",
    "tests/drivers/test_bus.py",
    "tests/app/test_lowest_versions.py",
    "tests/app/test_cli.py",
    "tests/app/test_config.py",
    "tests/app/test_conversions.py",
    "tests/app/test_doctor.py",
)
"""What touches numpy, scipy, filterpy, pydantic, typer, rich, python-can, cantools, pyarrow most; half a CPU minute."""
LEFT_OUT = ("all", "fmu")
"""Extras that are not installed here by name: the sum of all, and what has a numpy of its own."""


def extras() -> dict[str, list[str]]:
    """The extras that are tried, with their packages."""
    document = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    return {name: of for name, of in document["project"]["optional-dependencies"].items() if name not in LEFT_OUT}


def lowest() -> str:
    """Constraints for pip: every named package at its lowest version, one a line."""
    document = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    named = [*document["project"]["dependencies"], *document["dependency-groups"]["test"]]
    named += [package for packages in extras().values() for package in packages]
    assert all(package.count(">=") == 1 for package in named), named
    without_extras = (re.sub(r"\[.*?\]", "", package) for package in named)  # pip's constraints take none
    return "\n".join(package.replace(">=", "==") for package in without_extras) + "\n"


def run(*arguments: str | Path) -> None:
    """Run one program of the environment; it ends this script where it fails."""
    command = [str(argument) for argument in arguments]
    print("==", *command, flush=True)
    done = subprocess.run([str(PYTHON), *command], cwd=ROOT, check=False)
    if done.returncode:
        sys.exit(done.returncode)


def environment(source: Path) -> None:
    """Make the environment, unless it is there with these versions; what is in source is installed anew in any case."""
    constraints, pip = lowest(), ("-m", "pip", "install", "-q", "--no-compile", "--disable-pip-version-check")
    if STAMP.exists() and STAMP.read_text("utf-8") == constraints:
        run(*pip, "--no-deps", "--force-reinstall", source)
        return
    venv.create(ENVIRONMENT, with_pip=True, clear=True)
    chosen = ENVIRONMENT / "constraints.txt"
    chosen.write_text(constraints, "utf-8")
    run(*pip, "--upgrade", "pip>=25.1")
    run(*pip, f"{source}[{','.join(extras())}]", "--group", "test", "-c", chosen)
    chosen.rename(STAMP)


def main() -> None:
    """Make the environment, show what is in it, run."""
    with tempfile.TemporaryDirectory() as folder:  # a copy: nothing is built in the tree, where others may be at work
        source = Path(folder) / "source"
        shutil.copytree(ROOT, source, symlinks=True, ignore=NOT_SOURCE)
        environment(source)
    run("-m", "pip", "list", "--disable-pip-version-check")
    run("-m", "retuner", "run", "examples/oven.toml", "--no-compare", "--out", "runs/lowest")
    # newer packages deprecate what the old ones beside them call: a warning is no error here
    run("-P", "-m", "pytest", "-q", "-o", "filterwarnings=default", "-p", "no:cacheprovider", *TESTS)


if __name__ == "__main__":
    main()
