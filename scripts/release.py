"""Build what is released and try it as users will: archives, clean environments, a list of what is inside.

    python scripts/release.py [--python 3.11 3.12 ...] [--require 3.11 ...] [--out dist]

Makes in --out the sdist, a wheel with the compiled engine, one without (for machines that have no such wheel), and an
SBOM (CycloneDX) of the base install with every extra. The wheels are installed into new environments, that with the
engine for every interpreter that is found (python3.N on PATH, or pyenv's), the other for the oldest, with nothing but
their own dependencies, and used there: the doctor, a configuration, a fit, a short retuned run. An interpreter that is
required and missing is a failure.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
NOT_SOURCE = shutil.ignore_patterns(
    ".*", "build", "dist", "runs", "site", "*.egg-info", "__pycache__", "htmlcov", "*.so"
)
WITHOUT_ENGINE = "RETUNER_WITHOUT_ENGINE"
RECORD = ROOT / "tests" / "data" / "release_step.csv"
TOOLS = ("build", "twine>=6.1")
SBOM_TOOL = "cyclonedx-bom>=7"


@dataclass(frozen=True)
class Trial:
    """A wheel in a new environment of an interpreter."""

    version: str
    interpreter: str
    wheel: Path

    @property
    def compiled(self) -> bool:
        """Whether the engine is in the wheel."""
        return "none-any" not in self.wheel.name


def run(*command: str | Path, cwd: Path | None = None, **environment: str) -> str:
    """Run a command; what it printed. It ends this script where it fails."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "COV", "VIRTUAL_ENV"))}
    kept["PIP_NO_COMPILE"] = "1"  # these environments are used once: what is not imported needs no bytecode
    done = subprocess.run(
        list(map(str, command)), cwd=cwd, env=kept | environment, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise SystemExit(f"{' '.join(map(str, command))} failed:\n{done.stdout}{done.stderr}")
    return done.stdout


def archives(tools: Path, out: Path) -> tuple[Path, list[Path]]:
    """The sdist, and the wheels made from it alone, as an installer would make them."""
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "source"
        shutil.copytree(ROOT, source, symlinks=True, ignore=NOT_SOURCE)
        run(tools, "-P", "-m", "build", "--sdist", "--outdir", out, source)
    sdist = next(out.glob("*.tar.gz"))
    for setting in ({}, {WITHOUT_ENGINE: "1"}):
        run(tools, "-P", "-m", "pip", "wheel", "-q", "--no-deps", "--no-cache-dir", "-w", out, sdist, **setting)
    return sdist, sorted(out.glob("*.whl"))


def tried(trial: Trial) -> str:
    """Install a wheel and use it from an empty folder; a line that says so."""
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder) / "home"
        home.mkdir()
        run(trial.interpreter, "-m", "venv", "--without-pip", Path(folder) / "venv")  # ours installs into it
        python = Path(folder) / "venv" / "bin" / "python"
        pip = (sys.executable, "-P", "-m", "pip", "--python", python)
        run(*pip, "install", "-q", "--disable-pip-version-check", trial.wheel)
        retuner = python.with_name("retuner")
        told = json.loads(run(retuner, "doctor", "--json", cwd=home))
        engine = next(one for one in told["findings"] if one["name"] == "engine of fits")
        if engine["what"].startswith("compiled") != trial.compiled:
            raise SystemExit(f"{trial.wheel.name}: {engine}")
        shutil.copy(RECORD, home / "step.csv")
        found = json.loads(run(retuner, "identify", "step.csv", "--open-loop", "--json", cwd=home))
        run(retuner, "init", "loop.toml", cwd=home)
        run(retuner, "check", "loop.toml", cwd=home)
        shutil.copy(ROOT / "examples" / "bench.toml", home)
        if trial.compiled:
            run(retuner, "run", "bench.toml", "--no-compare", "--out", "out", "-q", cwd=home)
            run(retuner, "ledger", "verify", "out", cwd=home)
    gain = found["model"]["k"]
    return f"{trial.version}: {trial.wheel.name}: installed and used; {engine['what']}; k {gain:.4g}"


def sbom(python: str, wheel: Path, out: Path, tools: Path) -> Path:
    """CycloneDX list of the base install with every extra."""
    version = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["version"]
    path = out / f"retuner-{version}.cdx.json"
    with tempfile.TemporaryDirectory() as folder:
        run(python, "-m", "venv", Path(folder) / "venv")
        inside = Path(folder) / "venv" / "bin" / "python"
        run(inside, "-m", "pip", "install", "-q", "--disable-pip-version-check", f"{wheel}[all]")
        run(inside, "-m", "pip", "uninstall", "-q", "-y", "pip", "setuptools")
        arguments = (
            "--pyproject",
            ROOT / "pyproject.toml",
            "--mc-type",
            "library",
            "--output-reproducible",
            "-o",
            path,
        )
        run(tools, "-P", "-m", "cyclonedx_py", "environment", *arguments, inside)
    return path


def _as_numbers(version: str) -> tuple[int, ...]:
    return tuple(map(int, version.split(".")))


def parsed() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", nargs="*", default=PYTHONS, help="versions to try, where they are found")
    parser.add_argument("--require", nargs="*", default=(), help="versions that must be found")
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="where the archives go; emptied first")
    parser.add_argument("--no-sbom", action="store_true", help="leave the list of what is inside away")
    return parser.parse_args()


def steps(options: argparse.Namespace) -> Iterator[str]:
    """Build, look at, try; a line each."""
    shutil.rmtree(options.out, ignore_errors=True)
    options.out.mkdir(parents=True)
    with tempfile.TemporaryDirectory() as folder:
        run(sys.executable, "-m", "venv", folder)
        tools = Path(folder) / "bin" / "python"
        more = () if options.no_sbom else (SBOM_TOOL,)
        run(tools, "-m", "pip", "install", "-q", "--disable-pip-version-check", *TOOLS, *more)
        sdist, wheels = archives(tools, options.out)
        run(tools, "-P", "-m", "twine", "check", "--strict", sdist, *wheels)
        yield f"built and checked: {', '.join(path.name for path in (sdist, *wheels))}"
        found = {}
        for version in options.python:
            of_pyenv = sorted((Path.home() / ".pyenv" / "versions").glob(f"{version}.*/bin/python"))
            places = [*map(str, of_pyenv), shutil.which(f"python{version}")]
            for place in filter(None, places):
                if run(place, "-c", "import sys; print('%d.%d' % sys.version_info[:2])").strip() == version:
                    found[version] = place
                    break
        missing = [version for version in options.require if version not in found]
        if missing:
            raise SystemExit(f"required and not found: Python {', '.join(missing)}")
        yield f"Python {', '.join(found)}; not found: {', '.join(set(options.python) - set(found)) or 'none'}"
        trials = [Trial(version, place, wheel) for version, place in found.items() for wheel in wheels]
        trials = [one for one in trials if one.compiled or one.version == min(found, key=_as_numbers)]
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            yield from pool.map(tried, trials)
        if not options.no_sbom:
            with_engine = next(wheel for wheel in wheels if "none-any" not in wheel.name)
            yield f"what is inside: {sbom(sys.executable, with_engine, options.out, tools).name}"


if __name__ == "__main__":
    for line in steps(parsed()):
        print(line, flush=True)
