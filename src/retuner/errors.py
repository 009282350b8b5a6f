"""What a person did wrong or must see to, in one line each: shown on stderr without a traceback, exit status 2.

    UserError            base: wrong use, bad input
    |-- ConfigError      a configuration file cannot be used (one line per problem, with file and line)
    `-- LedgerError      a ledger cannot be opened, written or believed

Errors of the rooms (drivers' DeviceError, RecordingError and so on) keep their own trees; cli.py shows them the same
way. A ValueError of the pure rooms is mapped where the command knows which option or key it came from: user_input().
"""

from collections.abc import Iterator
from contextlib import contextmanager

ESCAPES = str.maketrans({"\n": "\\n", "\r": "\\r", "\t": "\\t"})


def one_line(text: object) -> str:
    """The text on one line: line ends and other unprintable characters (terminal escapes too) written as escapes."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in str(text).translate(ESCAPES))


class UserError(Exception):
    """Something that the user can put right.

    lines : one line per problem: what, where, the limit, what to do.
    """

    exit_status = 2

    def __init__(self, *lines: str) -> None:
        self.lines = tuple(one_line(line) for line in lines)
        super().__init__("\n".join(self.lines))


class ConfigError(UserError):
    """A configuration file that cannot be used."""


class LedgerError(UserError):
    """A ledger that cannot be opened, written or believed."""


@contextmanager
def user_input(where: str) -> Iterator[None]:
    """Turn a ValueError of the pure rooms into a UserError that says where the value came from.

    where : the option, key or file that the values inside came from, for example "--tau1".

    Raises UserError: the block raised ValueError.
    """
    try:
        yield
    except ValueError as error:
        raise UserError(f"{where}: {error}") from error
