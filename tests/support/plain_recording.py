"""A recorded loop out of a plain file: columns t, pv, co and, where it is there, sp."""

from collections.abc import Mapping
from pathlib import Path

from retuner.drivers.recorded.recording import ROLES, Recording, read_columns


def read_recording(path: Path, columns: Mapping[str, str] | None = None) -> Recording:
    """Read it; columns : for a role ("t", "sp", "pv", "co") the name of its column, where that is another.

    Raises RecordingError: the file cannot be read or is malformed.
    """
    named = dict(columns or {})
    names = {role: named.get(role, role) for role in ROLES}
    wanted = [names[role] for role in ROLES if role != "sp" or role in named]
    table = read_columns(path, list(names.values()), wanted)
    arrays = {role: table[name] for role, name in names.items() if name in table}
    return Recording(str(path), arrays["t"], arrays["pv"], arrays["co"], arrays.get("sp"))
