"""The wheel, installed for real beside PyPI's own `schedule` and `adaptive`, breaks neither and works."""

import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from dataclasses import dataclass
from pathlib import Path

import pytest
from once import once

ROOT = Path(__file__).resolve().parents[2]
ROOMS = {"schedule": ROOT / "schedule", "adaptive": ROOT / "adaptive", "drivers": ROOT / "drivers"}
NOT_SOURCE = shutil.ignore_patterns(".*", "build", "dist", "runs", "*.egg-info", "__pycache__", "htmlcov")
NEIGHBOURS = ("schedule", "adaptive")
OFFLINE = ("NewConnectionError", "Temporary failure in name resolution", "No matching distribution", "timed out")

pytestmark = pytest.mark.nightly  # in CI scripts/release.py installs and tries the wheels


@dataclass(frozen=True)
class Installed:
    """The built archives, and the environment in which the wheel was installed."""

    wheel: Path
    sdist: Path
    python: Path
    retuner: Path
    folder: Path

    def run(self, *command: str | Path) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            list(map(str, command)),
            capture_output=True,
            text=True,
            check=False,
            cwd=self.folder,
            env=clean_environment(),
        )

    def origin(self, module: str) -> Path:
        done = self.run(self.python, "-P", "-c", f"import {module}; print({module}.__file__)")
        assert done.returncode == 0, done.stderr
        return Path(done.stdout.strip())


def clean_environment() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "COV", "VIRTUAL_ENV"))}


def checked(*command: str | Path) -> None:
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False, env=clean_environment())
    if done.returncode and any(sign in done.stderr for sign in OFFLINE) and not os.environ.get("CI"):
        pytest.skip(f"the package index cannot be reached: {done.stderr.strip().splitlines()[-1]}")
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    folder = once(tmp_path_factory, "wheel", install)
    wheel, sdist = next((folder / "dist").glob("*.whl")), next((folder / "dist").glob("*.tar.gz"))
    binaries = folder / "venv" / "bin"
    return Installed(wheel, sdist, binaries / "python", binaries / "retuner", folder / "empty")


def install(folder: Path) -> None:
    """Build sdist and wheel from a copy of the sources and install the wheel into a new environment.

    The dependencies are seen through a .pth line, which shows a folder's packages but runs no .pth of that folder, so
    the editable install beside them stays unseen.
    """
    shutil.copytree(ROOT, folder / "source", ignore=NOT_SOURCE)
    checked(sys.executable, "-P", "-m", "build", "--no-isolation", "--outdir", folder / "dist", folder / "source")
    checked(sys.executable, "-P", "-m", "venv", folder / "venv")
    python = folder / "venv" / "bin" / "python"
    site = Path(sysconfig.get_path("purelib", vars={"base": str(folder / "venv")}))
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    pip = (python, "-P", "-m", "pip", "install", "-q", "--disable-pip-version-check")
    checked(*pip, *NEIGHBOURS)
    checked(*pip, "--no-deps", "--ignore-installed", next((folder / "dist").glob("*.whl")))
    (folder / "empty").mkdir()


def test_the_wheel_owns_nothing_but_retuner(installed: Installed) -> None:
    with zipfile.ZipFile(installed.wheel) as archive:
        names = archive.namelist()
    assert {name.split("/")[0].split("-")[0] for name in names} == {"retuner"}
    for room, folder in ROOMS.items():
        modules = {path.relative_to(folder).as_posix() for path in folder.rglob("*.py")}
        assert modules == {
            n.removeprefix(f"retuner/{room}/") for n in names if n.startswith(f"retuner/{room}/") and n.endswith(".py")
        }
    hall = {path.relative_to(ROOT / "src").as_posix() for path in (ROOT / "src").rglob("*") if path.is_file()}
    assert {name for name in hall if "__pycache__" not in name and "egg-info" not in name} <= set(names)
    assert "retuner/drivers/retuner.dbc" in names
    assert {"retuner/py.typed", "retuner/templates/starter.toml"} <= set(names)
    assert any(name.endswith("licenses/LICENSE") for name in names)


def test_the_sdist_has_what_a_packager_needs(installed: Installed) -> None:
    with tarfile.open(installed.sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {
        "Makefile",
        "LICENSE",
        "README.md",
        "CHANGELOG.md",
        "tests/app/test_wheel.py",
        "setup.py",
        "drivers/retuner.dbc",
        "scripts/link_typing.py",
    } <= names
    assert any(name.startswith("examples/") for name in names)


def test_neighbours_and_rooms_stand_side_by_side(installed: Installed) -> None:
    site = installed.python.parents[1] / "lib"
    for name in NEIGHBOURS:
        theirs, ours = installed.origin(name), installed.origin(f"retuner.{name}")
        assert theirs.is_relative_to(site)
        assert ours.is_relative_to(site)
        assert theirs.parent.name != "retuner"
        assert ours.parts[-3:] == ("retuner", name, "__init__.py")
    assert installed.run(installed.python, "-P", "-c", "import schedule; schedule.every").returncode == 0
    missing = installed.run(installed.python, "-P", "-c", "import drivers")
    assert "No module named 'drivers'" in missing.stderr


def test_the_installed_command_works(installed: Installed) -> None:
    shown = installed.run(installed.retuner, "--help")
    assert (shown.returncode, shown.stderr) == (0, "")
    assert "check" in shown.stdout
    assert installed.run(installed.retuner, "init", "a.toml").returncode == 0
    answer = installed.run(installed.retuner, "check", "a.toml")
    assert (answer.returncode, answer.stderr) == (0, "")
    tuned = installed.run(installed.python, "-P", "-m", "retuner", "--version")
    assert tuned.returncode == 0, tuned.stderr
