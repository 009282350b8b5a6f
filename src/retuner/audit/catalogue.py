"""Which loops a plant's files hold: found by the names of columns, of files or of folders, nothing being read whole.

A file of one loop without tags is that loop's record, called by the file's name, or by the part of it that
`--tag-pattern` names. Without a pattern, a tag before a date (FIC101_0614.csv) is the loop, and files of one tag are
its records: else one bad valve would fill the list. Loops that share their text files are one task: text is read once.
Of Parquet files that loops share, a task takes as many loops as fit a piece; a loop longer than that is read in pieces,
where every file has all of its signals.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from retuner.drivers.historian.loop_record import FILES_OF_A_FOLDER, TRAFFIC, traffic_names
from retuner.drivers.historian.parquet_tables import MOST_ROWS, long_names, parquet_shape
from retuner.drivers.historian.raw_table import read_text_table
from retuner.drivers.historian.record_form import SIGNALS, RecordForm
from retuner.drivers.historian.tags import loops, named
from retuner.drivers.recorded.recording import RecordingError
from retuner.schedule.late_dataclass import dataclass, field, replace

BEGIN_BYTES = 65_536  # bytes of a text file that tell its form
ANY_FAULT = (ArithmeticError, AttributeError, LookupError, MemoryError, OSError, RuntimeError, TypeError, ValueError)
"""What costs a file or a loop itself and no other: bad input, and faults of this program in a record like no other."""
WHOLE = frozenset({"pv", "co"})
DATED = re.compile(r"^(\d{0,4}[A-Z]{2,5}[-_]?\d{2,6}[A-Z]?)[ _-](?=(?:\d{1,3}[ _-])*\d{4})[\d ._:T-]+$")
"""A tag (letters of its function, number) before digits that hold a date; FIC101_1 and FIC101_2 may be two loops."""
FEW, MANY = 4, 64
"""Loops of a task at most, of wide Parquet files and of long ones, which are looked through for each task."""


@dataclass(frozen=True, slots=True)
class Task:
    """Loops that are read together.

    tags : of the loops. files : that hold them. separate : each file is a record of its own (with its own clock).
    in_pieces : the loop is read in pieces of MOST_ROWS rows.
    """

    tags: tuple[str, ...]
    files: tuple[Path, ...]
    separate: bool = False
    in_pieces: bool = False


@dataclass(frozen=True, slots=True)
class _HeldFile:
    """What a file holds: names of signals as it writes them by role and tag, names that are none; its size in rows.

    rows : of a Parquet file, 0 of text. long : it has a row for each value.
    """

    signals: Mapping[str, Mapping[str, str]]
    others: tuple[str, ...] = ()
    rows: int = 0
    long: bool = False


@dataclass(frozen=True, slots=True)
class Catalogue:
    """The tasks; files that are no record, with the reason; how names were joined to loops.

    signals : names by tag and role. others : names that no loop has.
    """

    tasks: tuple[Task, ...]
    refused: tuple[tuple[Path, str], ...]
    signals: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    others: tuple[str, ...] = ()

    @property
    def tags(self) -> tuple[str, ...]:
        """All loops."""
        return tuple(tag for task in self.tasks for tag in task.tags)


def told_fault(error: BaseException) -> str:
    """A fault in a line; one that is none of the input's says its kind, for whoever mends this program."""
    return f"{'' if isinstance(error, RecordingError) else f'{type(error).__name__}: '}{error}"


def files_of(sources: Iterable[Path]) -> list[Path]:
    """The files of folders and patterns, in order; names that begin with a point are not the plant's.

    Raises RecordingError: there is no such file or folder.
    """
    found: list[Path] = []
    for source in sources:
        if source.is_dir():
            known = FILES_OF_A_FOLDER + TRAFFIC
            inside = (p for p in source.rglob("*") if p.suffix.lower() in known and p.is_file())
            found += sorted(p for p in inside if not any(part.startswith(".") for part in p.relative_to(source).parts))
        elif source.is_file():
            found.append(source)
        else:
            matching = sorted(Path(source.anchor or ".").glob(str(source.relative_to(source.anchor or "."))))
            if not matching:
                raise RecordingError(f"{source}: no such file or folder; give a folder of exports, or a pattern")
            found += [p for p in matching if p.is_file()]
    return list(dict.fromkeys(found))


def catalogue(files: Sequence[Path], form: RecordForm, tag_pattern: str = "") -> Catalogue:
    """What the files hold.

    files : as files_of gives them. form : what is known of their form. tag_pattern : a regular expression; what its
    first group finds in a file's name is the tag of a record without tags. None: a tag before a date is one.
    """
    held: dict[Path, _HeldFile] = {}
    refused: list[tuple[Path, str]] = []
    for path in files:
        try:
            held[path] = _held(path, form)
        except ANY_FAULT as error:
            refused.append((path, told_fault(error)))
        else:
            if not held[path].signals:
                refused.append((path, f"{path}: neither its columns nor its name show a loop's pv or co"))
    alone: dict[str, list[Path]] = {}
    apart: dict[str, list[Path]] = {}
    signals: dict[str, dict[str, str]] = {}
    for path, one in held.items():
        for tag, roles in one.signals.items():
            signals.setdefault(tag, {}).update(roles)
            if tag or roles.keys() < WHOLE:
                apart.setdefault(tag, []).append(path)
            else:
                match = re.search(tag_pattern, path.name) if tag_pattern else DATED.match(path.stem)
                name = path.stem if match is None else match.group(1 if match.groups() else 0)
                alone.setdefault(name, []).append(path)
    shared = _shared(apart, held, refused)
    twice = alone.keys() & {tag for task in shared for tag in task.tags}
    said = "its name says loop {}, which other files hold by their columns; rename it, or give --tag-pattern"
    refused += [(path, f"{path}: {said.format(tag)}") for tag in sorted(twice) for path in alone[tag]]
    tasks = [Task((tag,), tuple(paths), separate=True) for tag, paths in alone.items() if tag not in twice]
    others = tuple(dict.fromkeys(name for one in held.values() for name in one.others))
    return Catalogue((*tasks, *shared), tuple(refused), signals, others)


def _shared(
    apart: Mapping[str, list[Path]], held: Mapping[Path, _HeldFile], refused: list[tuple[Path, str]]
) -> list[Task]:
    """Tasks of tagged loops: those of the same files together, of Parquet as many as fit a piece."""
    together: dict[tuple[Path, ...], list[str]] = {}
    for tag, paths in apart.items():
        missing = WHOLE - {role for path in paths for role in held[path].signals[tag]}
        if missing:
            refused.append((paths[0], f"{tag}: no {', '.join(sorted(missing))} in any file"))
        else:
            together.setdefault(tuple(paths), []).append(tag)
    tasks = []
    for files, tags in together.items():
        if all(path.suffix.lower() == ".parquet" for path in files):
            sizes = [held[path] for path in files]
            long = any(one.long for one in sizes)
            rows = sum(one.rows // max(len(one.signals), 1) if one.long else one.rows for one in sizes)
            count = max(min(MOST_ROWS // max(rows, 1), MANY if long else FEW), 1)
            whole = not long and all(one.signals.get(tag, {}).keys() >= WHOLE for tag in tags for one in sizes)
            in_pieces = rows > MOST_ROWS and whole
            tasks += [Task(tuple(tags[i : i + count]), files, in_pieces=in_pieces) for i in range(0, len(tags), count)]
        else:
            tasks.append(Task(tuple(tags), files))
    return tasks


def _held(path: Path, form: RecordForm) -> _HeldFile:
    if path.suffix.lower() in TRAFFIC:
        return _HeldFile(*_roles(traffic_names(path, form), form))
    if path.suffix.lower() != ".parquet":
        table = read_text_table(path, replace(form, words={}, signals={}), BEGIN_BYTES)
        if not _is_long(table.names):
            return _of_columns(path, table.names, form)
        tags = read_text_table(path, form).columns[loops(table.names)[""]["tag"][0]]
        return _HeldFile(*_roles(list(dict.fromkeys(str(field).strip() for field in tags)), form), long=True)
    shape = parquet_shape(path)
    if _is_long([form.called(name) for name in shape.names]):
        return _HeldFile(*_roles(long_names(path, form), form), rows=shape.rows, long=True)
    if shape.folder_signal:
        return _HeldFile(*_roles([shape.folder_signal], form), rows=shape.rows)
    return replace(_of_columns(path, shape.names, form), rows=shape.rows)


def _is_long(names: Sequence[str]) -> bool:
    """Whether a table of these columns has a row for each value."""
    found = loops(names)
    return found.get("", {}).keys() >= {"tag", "value"} and not any(WHOLE & roles.keys() for roles in found.values())


def _roles(names: Sequence[str], form: RecordForm) -> tuple[dict[str, dict[str, str]], tuple[str, ...]]:
    signals: dict[str, dict[str, str]] = {}
    for tag, roles in loops([form.called(name) for name in names]).items():
        found = {role: names[places[0]] for role, places in roles.items() if role in SIGNALS}
        if found:
            signals[tag] = found
    return signals, tuple(name for name in names if not named(form.called(name)).role)


def _of_columns(path: Path, names: Sequence[str], form: RecordForm) -> _HeldFile:
    """What a wide file holds by its columns, else by its name."""
    signals, others = _roles(names, form)
    own = {role: name for role, name in form.columns.items() if role in SIGNALS and name in names}
    if own:
        signals[""] = {**signals.get("", {}), **own}
    if signals:
        return _HeldFile(signals, tuple(name for name in others if name not in form.columns.values()))
    by_name, _ = _roles([path.stem], form)
    return _HeldFile(by_name, () if by_name else others)
