"""A user's own project beside an editable install of a clone: Python and type checkers find the same package.

The clone conflicts with the user's script under its own name, `retuner`, where it used to hide the package.
"""

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest
from once import once

ROOT = Path(__file__).resolve().parents[2]
NOT_SOURCE = shutil.ignore_patterns(
    ".*", "build", "dist", "runs", "*.egg-info", "__pycache__", "htmlcov", "tests", "docs", "*.so"
)
SCRIPT = """
from retuner import Decision, PidController, PidGains, Regions, diagnose, identify, read
from retuner.schedule.pid import PidLaw

pid = PidController(PidGains.from_ideal(2.0, 20.0), dt_s=1.0, pv_range=(0.0, 100.0), mode="advise")
co: float = pid.step(50.0, 20.0)
made: Decision | None = pid.decision
print(co, PidLaw)
"""
WRONG = """
import retuner

co: str = retuner.PidController(retuner.PidGains(2.0, 0.1), dt_s=1.0, pv_range=(0.0, 100.0)).step(50.0, 20.0)
retuner.identfy
"""

pytestmark = pytest.mark.nightly


def clean_environment() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "COV", "VIRTUAL_ENV"))}


def call(*command: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        list(map(str, command)), capture_output=True, text=True, check=False, cwd=cwd, env=clean_environment()
    )


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the clone, an environment in which it is installed editable, and the user's script."""
    return once(tmp_path_factory, "users_project", install)


def install(folder: Path) -> None:
    """The dependencies are seen through a .pth line, as in test_wheel.py."""
    (folder / "retuner").mkdir()
    for source in ROOT.iterdir():
        if not source.is_symlink() and source.name not in NOT_SOURCE(str(ROOT), [source.name]):
            (shutil.copytree if source.is_dir() else shutil.copy)(source, folder / "retuner" / source.name)
    for room in ("schedule", "adaptive", "drivers"):
        shutil.rmtree(folder / "retuner" / "src" / "retuner" / room, ignore_errors=True)  # links, copied as folders
    assert call(sys.executable, "-P", "-m", "venv", "--without-pip", folder / "venv", cwd=folder).returncode == 0
    python = folder / "venv" / "bin" / "python"
    site = Path(sysconfig.get_path("purelib", vars={"base": str(folder / "venv")}))
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    pip = (
        sys.executable,
        "-P",
        "-m",
        "pip",
        "--python",
        python,
        "install",
        "-q",
        "--disable-pip-version-check",
        "--no-deps",
        "--ignore-installed",
    )
    done = call(*pip, "--no-build-isolation", "-e", folder / "retuner", cwd=folder)
    assert done.returncode == 0, done.stderr
    (folder / "script.py").write_text(SCRIPT)
    (folder / "wrong.py").write_text(WRONG)


def test_a_clone_beside_the_script_does_not_hide_the_package(project: Path) -> None:
    done = call(project / "venv" / "bin" / "python", "script.py", cwd=project)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("60.0")


def test_mypy_finds_every_type(project: Path) -> None:
    done = call(sys.executable, "-P", "-m", "mypy", "--strict", *checking(project), "script.py", cwd=project)
    assert done.returncode == 0, done.stdout + done.stderr


def test_mypy_finds_what_is_wrong(project: Path) -> None:
    done = call(sys.executable, "-P", "-m", "mypy", "--strict", *checking(project), "wrong.py", cwd=project)
    assert 'variable has type "str"' in done.stdout
    assert 'has no attribute "identfy"' in done.stdout


def checking(project: Path) -> tuple[str | Path, ...]:
    return "--python-executable", project / "venv" / "bin" / "python", "--cache-dir", project / "cache"
