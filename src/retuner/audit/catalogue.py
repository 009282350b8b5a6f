"""Which loops a plant's files hold: found by the names of columns, or of files, before anything is read whole.

A file of one loop without tags is that loop's record, called by the file's name, or by the part of it that
`--tag-pattern` names. Loops that share their files are one task: their text is read once.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from retuner.drivers.historian.frames import parquet_names, table_of_parquet
from retuner.drivers.historian.loop_record import FILES_OF_A_FOLDER
from retuner.drivers.historian.raw_table import RawTable, read_text_table
from retuner.drivers.historian.record_form import RecordForm
from retuner.drivers.historian.tags import loops, named
from retuner.drivers.recorded.recording import RecordingError

BEGIN_BYTES = 65_536
"""As much of a text file tells its form."""
WHOLE = frozenset({"pv", "co"})


@dataclass(frozen=True, slots=True)
class Task:
    """Loops that are read together.

    tags : of the loops. files : that hold them. separate : each file is a record of its own (with its own clock).
    """

    tags: tuple[str, ...]
    files: tuple[Path, ...]
    separate: bool = False


@dataclass(frozen=True, slots=True)
class Catalogue:
    """The tasks, and files that are no record, with the reason."""

    tasks: tuple[Task, ...]
    refused: tuple[tuple[Path, str], ...]

    @property
    def tags(self) -> tuple[str, ...]:
        """All loops."""
        return tuple(tag for task in self.tasks for tag in task.tags)


def files_of(sources: Iterable[Path]) -> list[Path]:
    """The files of folders and patterns, in order; names that begin with a point are not the plant's.

    Raises
    ------
    RecordingError
        There is no such file or folder.
    """
    found: list[Path] = []
    for source in sources:
        if source.is_dir():
            inside = (p for p in source.rglob("*") if p.suffix.lower() in FILES_OF_A_FOLDER and p.is_file())
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

    Parameters
    ----------
    files : as files_of gives them. form : what is known of their form. tag_pattern : a regular expression; what its
    first group finds in a file's name is the tag of a record without tags.
    """
    apart: dict[str, dict[Path, set[str]]] = {}
    alone: dict[str, list[Path]] = {}
    refused: list[tuple[Path, str]] = []
    for path in files:
        try:
            roles = _roles(path, form)
        except RecordingError as error:
            refused.append((path, str(error)))
            continue
        if "" in roles and roles[""] >= WHOLE:
            alone.setdefault(_by_name(path, tag_pattern), []).append(path)
            roles = {tag: found for tag, found in roles.items() if tag}
        for tag, found in roles.items():
            apart.setdefault(tag, {}).setdefault(path, set()).update(found)
        if not roles and path not in {p for some in alone.values() for p in some}:
            refused.append((path, f"{path}: neither its columns nor its name tell a loop's pv or co"))
    shared = _shared(apart, refused)
    twice = alone.keys() & {tag for task in shared for tag in task.tags}
    said = "by its name loop {}, which other files hold by their columns; rename it, or give --tag-pattern"
    refused += [(path, f"{path}: {said.format(tag)}") for tag in sorted(twice) for path in alone[tag]]
    tasks = [Task((tag,), tuple(paths), separate=True) for tag, paths in alone.items() if tag not in twice]
    return Catalogue((*tasks, *shared), tuple(refused))


def _shared(apart: dict[str, dict[Path, set[str]]], refused: list[tuple[Path, str]]) -> list[Task]:
    """Tasks of tagged loops: those of the same files together, but a Parquet file's one by one."""
    together: dict[tuple[Path, ...], list[str]] = {}
    for tag, held in apart.items():
        missing = WHOLE - {role for roles in held.values() for role in roles}
        if missing:
            refused.append((next(iter(held)), f"{tag}: no {', '.join(sorted(missing))} in any file"))
        else:
            together.setdefault(tuple(held), []).append(tag)
    tasks = []
    for paths, tags in together.items():
        one_by_one = all(path.suffix.lower() == ".parquet" for path in paths)
        tasks += [Task((tag,), paths) for tag in tags] if one_by_one else [Task(tuple(tags), paths)]
    return tasks


def _roles(path: Path, form: RecordForm) -> dict[str, set[str]]:
    """Roles by tag that a file holds."""
    if path.suffix.lower() == ".parquet":
        names: Sequence[str] = parquet_names(path)
    else:
        names = read_text_table(path, form, BEGIN_BYTES).names
    found = {tag: set(roles) for tag, roles in loops(names).items()}
    plain = found.get("", set())
    if {"tag", "value"} <= plain and not any(WHOLE & roles for roles in found.values()):
        return _of_long(path, names, form)
    plain |= {role for role in form.columns if role in {"sp", "pv", "co"} and form.columns[role] in names}
    found = {tag: roles & {"sp", "pv", "co"} for tag, roles in {**found, "": plain}.items()}
    found = {tag: roles for tag, roles in found.items() if roles}
    if found:
        return found
    read = named(path.stem)
    role = "co" if read.role == "mv" else read.role
    return {read.tag: {role}} if role in {"sp", "pv", "co"} else {}


def _of_long(path: Path, names: Sequence[str], form: RecordForm) -> dict[str, set[str]]:
    """Roles by tag of a table with a row for each value: its tags must be read."""
    place = loops(names)[""]["tag"][0]
    if path.suffix.lower() == ".parquet":
        table: RawTable = table_of_parquet(path, lambda _: [names[place]])
        column = table.columns[0]
    else:
        column = read_text_table(path, form).columns[place]
    found: dict[str, set[str]] = {}
    for field in set(map(str, column)):
        read = named(field.strip())
        if read.role in {"sp", "pv", "co", "mv"}:
            found.setdefault(read.tag, set()).add("co" if read.role == "mv" else read.role)
    return found


def _by_name(path: Path, pattern: str) -> str:
    """The tag of a record without one: from its file's name."""
    match = re.search(pattern, path.name) if pattern else None
    if match is None:
        return path.stem
    return match.group(1) if match.groups() else match.group(0)


def form_for(task: Task, tag: str, form: RecordForm) -> RecordForm:
    """The form under which one loop of a task is read."""
    return form if task.separate else replace(form, tag=tag)
