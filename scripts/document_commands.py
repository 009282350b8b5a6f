"""Write the page of all commands with their options, from the command line itself; `make docs` puts it into the site.

python scripts/document_commands.py
"""

import re
import sys
from collections.abc import Iterator

import typer
from typer.core import TyperArgument, TyperCommand, TyperGroup, TyperOption
from typer.main import get_command

from retuner.cli import COMMANDS, app_of

HEAD = """# Commands

`retuner COMMAND --help` shows the same on the terminal. With `--json` a command prints one JSON document and nothing
else on standard output. This page is made from the program when the site is built.

| exit status | means |
|---|---|
| 0 | done; yes |
| 1 | the answer to the question is no: not identifiable, unstable, a broken chain |
| 2 | wrong use or bad input: one line says what, where, and what to do |
| 70 | a defect of retuner itself: please report it |
| 130 | interrupted with Ctrl-C |
"""


def page() -> str:
    """The page as Markdown."""
    return HEAD + "".join(line for name in COMMANDS for line in told(f"retuner {name}", command(name)))


def command(name: str) -> TyperCommand | TyperGroup:
    """A command with its options."""
    return get_command(app_of(name))


def told(name: str, one: TyperCommand | TyperGroup) -> Iterator[str]:
    """One command as a section; a command of commands, those below it."""
    inside = getattr(one, "commands", {})
    yield f"\n{'###' if name.count(' ') > 1 else '##'} {name}\n\n{escaped(one.help)}\n"
    context = one.make_context(name, [], resilient_parsing=True)
    if not inside:
        yield f"\n    {' '.join([name, *one.collect_usage_pieces(context)])}\n"
    if one.epilog:
        yield f"\n{example(one.epilog)}\n"
    rows = [row(parameter, context) for parameter in one.params if not hidden(parameter)]
    if rows and not inside:
        yield "\n| | |\n|---|---|\n" + "".join(rows)
    for below, inner in inside.items():
        yield from told(f"{name} {below}", inner)


def row(parameter: TyperOption | TyperArgument, context: typer.Context) -> str:
    """One argument or option with what it means."""
    record = parameter.get_help_record(context)
    left, right = record if record else (parameter.name, parameter.help or "")
    return f"| `{left.replace('|', ' or ')}` | {escaped(right)} |\n"


def hidden(parameter: TyperOption | TyperArgument) -> bool:
    """Whether a person is not to know of it: what processes hand to one another; and --help, which all have."""
    return parameter.name == "help" or getattr(parameter, "hidden", False)


def example(epilog: str) -> str:
    """The example at the end of a command's help, its commands as code."""
    what, _, commands = epilog.partition(": ")
    return f"{what}: " + ", ".join(f"`{one.strip()}`" for one in commands.split(";"))


def escaped(text: str) -> str:
    """Plain text as Markdown."""
    return re.sub(r"([|*_<\[\]\\])", r"\\\1", " ".join((text or "").split()))


if __name__ == "__main__":
    sys.stdout.write(page())
