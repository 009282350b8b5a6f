"""retuner serve: sessions in a browser, live and afterwards; and acting from there."""

import importlib.util
import sys
from pathlib import Path
from typing import Annotated

import typer

from retuner.errors import UserError

app = typer.Typer(add_completion=False)

NEEDED = ("starlette", "uvicorn")
MISSING = 'the page needs starlette and uvicorn; pip install "retuner[page]"'


@app.command(epilog="Example: retuner serve runs; retuner serve runs/demo --port 8020 --read-only")
def serve(
    runs: Annotated[Path, typer.Argument(metavar="RUNS", help="Folder of a session, or of several.")],
    port: Annotated[int, typer.Option(help="Where to listen; 0: any port that is free.", min=0, max=65535)] = 8017,
    host: Annotated[str, typer.Option(help="Address to listen at; others are open to all.")] = "127.0.0.1",
    name: Annotated[list[str] | None, typer.Option(help="A host name under which browsers may ask.")] = None,
    certificate: Annotated[Path | None, typer.Option(help="File with the TLS certificate (PEM).")] = None,
    key: Annotated[Path | None, typer.Option(help="File with its key (PEM).")] = None,
    read_only: Annotated[bool, typer.Option("--read-only", help="Nobody may act from there.")] = False,
    until_closed: Annotated[bool, typer.Option("--until-closed", hidden=True)] = False,
) -> int:
    """Show sessions in a browser, live and afterwards; whoever has the token that is printed may act from there."""
    if not all(importlib.util.find_spec(one) for one in NEEDED):
        raise UserError(MISSING)
    from retuner.serve import server  # noqa: PLC0415  an extra, loaded when wanted

    for file in (certificate, key):
        if file is not None and not file.is_file():
            raise UserError(f"{file}: there is no such file; TLS needs --certificate and --key")
    options = server.ServeOptions(host, port, tuple(name or ()), certificate, key, read_only, until_closed)
    server.serve(runs, options, _say)
    return 0


def _say(line: str) -> None:
    """A line, at once."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()
