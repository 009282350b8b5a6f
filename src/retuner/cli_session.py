"""What is done with a recorded or running session: signatures and help only, as in cli.py."""

from pathlib import Path
from typing import Annotated

import typer

Json = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]
Session = Annotated[Path, typer.Argument(metavar="SESSION", help="Folder that a run leaves, or fills right now.")]


def replay(
    target: Annotated[
        Path, typer.Argument(metavar="SESSION|LOG", help="A session's folder; or, with --config, a log.")
    ],
    config: Annotated[
        Path | None,
        typer.Option(help="Say what would have been done on a log (.csv, .parquet, .blf, .asc, .mf4, candump .log)."),
    ] = None,
    columns: Annotated[str, typer.Option(help="Other names in a table: t=time,pv=temp,co=out,sp=target.")] = "",
    json: Json = False,
) -> int:
    """Decide again from recorded frames: the same, byte for byte? Or: what would you have done on this log?"""
    from retuner.commands.replay import replay as work

    return work(target, config=config, columns=columns, as_json=json)


ledger = typer.Typer(
    no_args_is_help=True, help="What was seen, decided and written: read it, and look whether it can be believed.",
    epilog="Example: retuner ledger verify runs/demo/ledger.sqlite",
)  # fmt: skip


@ledger.command(epilog="Example: retuner ledger verify runs/demo/ledger.sqlite --head 61f2ae1c0d3b")
def verify(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="ledger.sqlite of a run.")],
    head: Annotated[
        str | None, typer.Option(help="Hash that was noted when it was written; cut-off rows show.")
    ] = None,
    json: Json = False,
) -> int:
    """Recompute the hash chain: status 0 when it holds, 1 when it is broken, and where."""
    from retuner.commands.ledger import verify as work

    return work(file, head=head, as_json=json)
