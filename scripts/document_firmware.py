"""What the firmware in C takes of flash and RAM on ARM Cortex-M, written into drivers/firmware/README.md.

    python scripts/document_firmware.py            writes it
    python scripts/document_firmware.py --check    status 1 when the page says something else

It needs Debian's gcc-arm-none-eabi and libnewlib-arm-none-eabi.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

FIRMWARE = Path(__file__).resolve().parents[1] / "drivers" / "firmware"
PAGE = FIRMWARE / "README.md"
BEGIN, END = "<!-- written by scripts/document_firmware.py -->\n", "<!-- end -->"
NAMES = {"cortex-m0plus": "Cortex-M0+, float in software", "cortex-m4": "Cortex-M4F"}


def table() -> str:
    """The numbers as a table."""
    with tempfile.TemporaryDirectory() as folder:
        told = subprocess.run(
            ["make", "-s", "-C", str(FIRMWARE), f"BUILD={folder}", "arm"], check=True, capture_output=True, text=True
        ).stdout
    version = subprocess.run(["arm-none-eabi-gcc", "-dumpversion"], check=True, capture_output=True, text=True).stdout
    rows = []
    for line in told.splitlines():
        cpu, text, data, bss, *_ = line.split()
        rows.append(f"| {NAMES[cpu]} | {int(text) + int(data):,} | {int(data) + int(bss):,} |")
    head = f"| arm-none-eabi-gcc {version.strip()}, -Os | flash, bytes | RAM, bytes |\n|---|---|---|\n"
    return head + "\n".join(rows) + "\n"


def main() -> int:
    """Write or check the page."""
    page = PAGE.read_text(encoding="utf-8")
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    fresh = before + BEGIN + table() + END + after
    if "--check" in sys.argv[1:]:
        return int(fresh != page)
    PAGE.write_text(fresh, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
