"""A command, run in this process as the console script does."""

import io
import json
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any, NamedTuple

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


def printed(*arguments: str | Path, status: int = 0, silent: bool = False) -> str:
    """What a command prints. silent : and nothing on stderr; what takes long tells its progress there."""
    done = run(*arguments)
    assert done.returncode == status, done.stderr
    assert not (silent and done.stderr), done.stderr
    return done.stdout


def answer(*arguments: str | Path, status: int = 0, silent: bool = False) -> Any:
    """What a command answers with --json; silent as above."""
    return json.loads(printed(*arguments, "--json", status=status, silent=silent))


def refused(*arguments: str | Path) -> str:
    """The one line with which a command refuses what it is given."""
    done = run(*arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1
    return done.stderr
