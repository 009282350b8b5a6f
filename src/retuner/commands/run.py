"""retuner run: watch and retune a loop, and leave report, ledger, trend and bus log behind."""

import typer

from retuner.commands.options import signed_by
from retuner.commands.work.run_options import RunOptions

app = typer.Typer(add_completion=False)


@app.command(epilog="Example: retuner run examples/oven.toml --out runs/oven")
@signed_by(RunOptions)
def run(options: RunOptions) -> int:
    """Run a configuration; the exit status."""
    from retuner.commands.work import run as work

    return work.run(options)
