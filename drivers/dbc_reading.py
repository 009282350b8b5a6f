"""A DBC text to a database, every way to fail told in one line.

cantools takes a lot: of damaged DBC files one in eight is read without complaint, with other names, places or scales.
So what is read is held to the frames that this release knows, and what still differs has another layout hash, which
both ends compare before anything is written.
"""

import logging

import cantools.database
from cantools.database.can.database import Database
from cantools.errors import Error as CantoolsError

from retuner.drivers.device import DeviceError

# cantools warns about doubled frames on stderr; what matters is in the DbcError.
logging.getLogger("cantools").addHandler(logging.NullHandler())

PARSING_ERRORS = (CantoolsError, ValueError, LookupError, TypeError, ArithmeticError, AttributeError, RecursionError)
"""What cantools raises on damaged texts."""


class DbcError(DeviceError):
    """A DBC that cannot be used; one line: file, what is wrong."""


def read_dbc(text: str, source: str) -> Database:
    """Read a DBC text.

    Parameters
    ----------
    text : content of the file. source : its name, for messages.

    Raises
    ------
    DbcError
        It is no DBC, or signals of a frame overlap or leave it.
    """
    try:
        database = cantools.database.load_string(text, database_format="dbc", strict=True)
    except PARSING_ERRORS as error:
        raise DbcError(f"{source}: is no usable DBC: {' '.join(str(error).split())[:200]}") from None
    if not isinstance(database, Database):
        raise DbcError(f"{source}: is no CAN database")
    return database
