"""retuner serve: sessions in a browser, live and afterwards; and acting from there."""

import socket
import sys
from pathlib import Path
from typing import Annotated

import typer

from retuner.errors import UserError
from retuner.serve.address import PORT, ServeOptions
from retuner.serve.page_beside_run import require_page

app = typer.Typer(add_completion=False)


@app.command(epilog="Example: retuner serve runs; retuner serve runs/demo --port 8020 --read-only")
def serve(
    runs: Annotated[Path, typer.Argument(metavar="RUNS", help="Folder of a session, or of several.")],
    port: Annotated[
        int | None,
        typer.Option(help=f"Port to listen on; 0: any free port. Default {PORT}, or a free one.", min=0, max=65535),
    ] = None,
    host: Annotated[
        str, typer.Option(help="Address to listen on; others than localhost are reachable by all.")
    ] = "127.0.0.1",
    name: Annotated[list[str] | None, typer.Option(help="A host name under which browsers may ask.")] = None,
    certificate: Annotated[Path | None, typer.Option(help="File with the TLS certificate (PEM).")] = None,
    key: Annotated[Path | None, typer.Option(help="File with its key (PEM).")] = None,
    read_only: Annotated[bool, typer.Option("--read-only", help="Read-only: no operator requests.")] = False,
    inherited: Annotated[int | None, typer.Option("--inherited", hidden=True)] = None,
) -> int:
    """Show sessions in a browser, live and afterwards; operator requests need the token that is printed."""
    require_page()
    from retuner.serve import server

    for file in (certificate, key):
        if file is not None and not file.is_file():
            raise UserError(f"{file}: there is no such file; TLS needs --certificate and --key")
    options = ServeOptions(
        host, port, tuple(name or ()), certificate, key, read_only, until_closed=inherited is not None
    )
    if inherited is None:
        server.serve(runs, options, _say)
    else:  # beside a run, which has the socket and has told the token
        token = sys.stdin.readline().strip()
        server.serve(runs, options, _say, socket.socket(fileno=inherited), token)
    return 0


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()
