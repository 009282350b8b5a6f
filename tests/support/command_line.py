"""A command, run in this process as the console script does."""

import io
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple

from retuner import cli


class Done(NamedTuple):
    """What a command left: status, stdout, stderr."""

    returncode: int
    stdout: str
    stderr: str


def run(*arguments: str | Path) -> Done:
    """Run a command in this process, as the console script does."""
    hook = sys.excepthook
    out, err = io.StringIO(), io.StringIO()
    try:
        with redirect_stdout(out), redirect_stderr(err):
            status = cli.main([str(argument) for argument in arguments])
    finally:
        sys.excepthook = hook
    return Done(status, out.getvalue(), err.getvalue())
