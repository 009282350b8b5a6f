"""Functional mock-up units for the tests, made from source as a user's tool would: compiled C, and PythonFMU."""

import subprocess
import sys
import zipfile
from pathlib import Path

import fmpy
import fmpy.fmi2
import fmpy.fmi3

ROOT = Path(__file__).resolve().parent.parent.parent
SOURCE = ROOT / "tests" / "data" / "fmu" / "lag_with_events.c"


def compiled(folder: Path, version: int) -> Path:
    """The lag with events for model exchange."""
    library = folder / f"lag{version}.so"
    headers = Path(fmpy.__file__).parent / "c-code"
    prefix, kind = (fmpy.fmi3, "FMU3Model") if version == 3 else (fmpy.fmi2, "FMU2Model")
    wanted = {name for name in dir(getattr(prefix, kind)) if name.startswith(f"fmi{version}")}
    text = SOURCE.read_text(encoding="utf-8").replace("F(", f"fmi{version}")
    rest = folder / f"rest{version}.c"  # FMPy looks for every function of the standard
    rest.write_text(
        "".join(f"int {n}(void) {{ return 3; }}\n" for n in sorted(wanted) if f"{n}(" not in text.replace(")(", "("))
    )
    flags = ["-shared", "-fPIC", "-w", f"-I{headers}", *(["-DFMI3"] if version == 3 else [])]
    subprocess.run(["cc", *flags, "-o", str(library), str(SOURCE), str(rest), "-lm"], check=True)
    unit = folder / f"lag{version}.fmu"
    place = "x86_64-linux" if version == 3 else "linux64"
    with zipfile.ZipFile(unit, "w") as archive:
        archive.write(SOURCE.parent / f"description_{version}.xml", "modelDescription.xml")
        archive.write(library, f"binaries/{place}/lag.so")
    return unit


def heater(folder: Path) -> Path:
    """The heater of the examples, as its head says that it is made."""
    source = ROOT / "examples" / "plants" / "heater_fmu.py"
    folder.mkdir(exist_ok=True)
    subprocess.run([sys.executable, "-m", "pythonfmu", "build", "-f", str(source), "-d", str(folder)], check=True)
    return folder / "Heater.fmu"
