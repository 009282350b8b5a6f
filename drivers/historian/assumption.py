"""What was assumed in reading a record: told in a line, and in full with the key that fixes it otherwise."""

from retuner.schedule.late_dataclass import dataclass


@dataclass(frozen=True, slots=True)
class Assumption:
    """One thing that the record left open.

    what : what was taken to be the case, in a few words. key : the key of a RecordForm that fixes it, and its value as
    TOML; empty where it is only told (rows that were dropped).
    """

    what: str
    key: str = ""


def in_a_line(assumed: tuple[Assumption, ...]) -> str:
    """All assumptions in a line, short."""
    return "; ".join(a.what for a in assumed)


def in_full(assumed: tuple[Assumption, ...]) -> list[str]:
    """A line each: what could stand in a [record] section, and what it means."""
    lines = [f"{a.key:<40}  # {a.what}" for a in assumed if a.key]
    return ["[record]", *lines, *[f"# {a.what}" for a in assumed if not a.key]]


def quoted(text: str) -> str:
    """A text as a TOML string."""
    known = {'"': '\\"', "\\": "\\\\"}
    escaped = "".join(known.get(c, c if c.isprintable() else f"\\U{ord(c):08x}") for c in text)
    return f'"{escaped}"'
