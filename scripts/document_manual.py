"""Write docs/retuner.1, the manual page that is installed as `man retuner`, from the command line itself.

python scripts/document_manual.py [--check]
"""

import re
import sys
from collections.abc import Iterator
from pathlib import Path

from document_commands import command, hidden
from typer.core import TyperCommand, TyperGroup

from retuner.cli import COMMANDS

PAGE = Path(__file__).resolve().parent.parent / "docs" / "retuner.1"
HEAD = r""".TH RETUNER 1 "" "retuner" "User Commands"
.SH NAME
retuner \- gain scheduling and on-line adaptive PID over CAN
.SH SYNOPSIS
.B retuner
.RB [ \-q | \-v ]
.I COMMAND
.RI [ ARGUMENTS ]
.SH DESCRIPTION
retuner watches a control loop, learns its process in each operating region, names the cause of bad behaviour, works
out better PID settings, proves them, writes them over CAN, and rolls them back where they turn out worse.
.PP
Every command takes
.BR \-h ", " \-\-help ,
.BR \-q ", " \-\-quiet
(the answer and errors, and nothing else) and
.BR \-v ", " \-\-verbose
(what is done, on standard error;
.B \-vv
everything). With
.B \-\-json
one JSON document is printed on standard output and nothing else.
.SH COMMANDS
"""
TAIL = r""".SH EXIT STATUS
.TP
.B 0
done; yes
.TP
.B 1
the answer to the question is no: not identifiable, unstable, a broken chain
.TP
.B 2
wrong use or bad input: one line says what, where, and what to do
.TP
.B 70
a defect of retuner itself: please report it
.TP
.B 130
interrupted with Ctrl-C
.SH ENVIRONMENT
.TP
.B NO_COLOR
if set, no colour on terminals
.TP
.B RETUNER_ENGINE
which engine computes fits: auto (default), c, or numpy
.TP
.B RETUNER_TRACEBACK
if set, a defect of retuner shows its traceback
.SH EXAMPLES
.nf
"""
END = r""".fi
.SH SEE ALSO
.BR candump (1),
.BR ip (8).
The documentation has its address in the package's metadata.
"""


def page() -> str:
    """The page in man's own markup."""
    named = {name: command(name) for name in COMMANDS}
    examples = [line for one in named.values() for line in shown(one)]
    return (
        HEAD
        + "".join(part for name, one in named.items() for part in told(name, one))
        + TAIL
        + ("".join(f"{line}\n" for line in examples) + END)
    )


def told(name: str, one: TyperCommand | TyperGroup) -> Iterator[str]:
    """One command; a command of commands, those below it."""
    inside = getattr(one, "commands", {})
    context = one.make_context(name, [], resilient_parsing=True)
    if not inside:
        pieces = [piece for piece in one.collect_usage_pieces(context) if piece != "[OPTIONS]"]
        yield f'.SS "{" ".join(["retuner", name, *pieces])}"\n{escaped(one.help)}\n'
        for parameter in one.params:
            record = None if hidden(parameter) else parameter.get_help_record(context)
            if record is not None:
                yield f".TP\n.B {escaped(record[0])}\n{escaped(record[1])}\n"
    for below, inner in inside.items():
        yield from told(f"{name} {below}", inner)


def shown(one: TyperCommand | TyperGroup) -> Iterator[str]:
    """The examples at the ends of the helps."""
    for inner in getattr(one, "commands", {}).values():
        yield from shown(inner)
    if one.epilog and not getattr(one, "commands", {}):
        yield from (escaped(part.strip()) for part in one.epilog.partition(": ")[2].split(";"))


def escaped(text: str | None) -> str:
    """Plain text as man's markup: hyphens that can be copied, no line that begins with a request."""
    plain = " ".join((text or "").split()).replace("\\", r"\e").replace("-", r"\-")
    return re.sub(r"^([.'])", r"\\&\1", plain)


def main() -> int:
    """Write, or with --check say whether the page is what it should be."""
    made = page()
    if "--check" in sys.argv[1:]:
        return int(PAGE.read_text("utf-8") != made)
    PAGE.write_text(made, "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
