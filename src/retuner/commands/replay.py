"""retuner replay: decide again from a session's recorded frames, or ask what would have been done on another log."""

import typer

from retuner.commands.options import signed_by
from retuner.commands.work.replay_options import ReplayOptions

app = typer.Typer(add_completion=False)


@app.command(epilog="Example: retuner replay runs/demo; retuner replay loop.csv --config loop.toml --columns pv=temp")
@signed_by(ReplayOptions)
def replay(options: ReplayOptions) -> int:
    """Replay a session or a log; the exit status."""
    from retuner.commands.work import replay as work

    return work.replay(options)
