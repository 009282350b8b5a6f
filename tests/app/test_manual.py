"""The manual page that is installed says what the commands say."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_the_manual_page_is_that_of_the_commands() -> None:
    script = ROOT / "scripts" / "document_manual.py"

    done = subprocess.run([sys.executable, script, "--check"], capture_output=True, text=True, check=False)

    assert done.returncode == 0, done.stderr or "write it anew: python scripts/document_manual.py"
