"""Configuration file to Config, and every problem of a file as one line each: file:line key what, limit, what to do."""

import difflib
import json
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path as FilePath
from typing import Any, NamedTuple, get_args

from pydantic import AliasChoices, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from retuner.config.model import SCHEMA, Config
from retuner.config.schedule_config import AxisConfig
from retuner.config.section import CrossCheckError, Problem, Section
from retuner.config.session_config import SessionConfig, loop_documents, written_at
from retuner.config.toml_lines import Path, toml_lines
from retuner.drivers.host.key_file import KeyFileError, read_key
from retuner.drivers.protocol.codec import DbcError
from retuner.drivers.telemetry.signal_source import SignalSource, find_signal
from retuner.errors import ConfigError, one_line
from retuner.products import product
from retuner.schedule.regions import CAN

# ---- pydantic's findings in this project's words: key, what is wrong, the limit, what to do

LONGEST_VALUE = 60  # characters of a value that a message repeats

MEANING = " (meaning: "

LIMITS: dict[str, str] = {
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "string_type": "must be text in quotes",
    "finite_number": "must be a finite number",
    "greater_than": "must be greater than {gt:g}",
    "greater_than_equal": "must be at least {ge:g}",
    "less_than": "must be less than {lt:g}",
    "less_than_equal": "must be at most {le:g}",
    "string_too_short": "must have at least {min_length} character",
    "string_too_long": "must have at most {max_length} characters",
    "too_short": "must have at least {min_length} entry",
    "too_long": "must have at most {max_length} entries",
    "tuple_type": "must be an array, [...]",
    "model_type": "must be a table",
    "model_attributes_type": "must be a table",
    "literal_error": "must be {expected}",
    "union_tag_invalid": "must have kind = one of {expected_tags}",
    "union_tag_not_found": "needs its kind; add one of oven, linear, boiler, state_space, python, fmu, identified",
}
"""What pydantic's error types mean here; the braces are filled from pydantic's context."""


def problems_of(errors: list[ErrorDetails], document: Mapping[str, object]) -> list[Problem]:
    """One problem per key; several findings about one value are joined by "or"."""
    found: dict[Path, list[str]] = {}
    for error in errors:
        # The location without the names of union members that pydantic puts into it
        path: Path = ()
        node: object = document
        for i, part in enumerate(error["loc"]):
            is_last = i == len(error["loc"]) - 1
            if isinstance(node, Mapping) and part == node.get("kind") and not is_last:
                continue
            if (isinstance(node, Mapping) and part in node) or (isinstance(node, list) and isinstance(part, int)):
                node = _inside(node, part)
            elif not (error["type"] == "missing" and is_last):
                continue
            path = (*path, part)
        for problem in _told(error, path, document):
            messages = found.setdefault(problem.path, [])
            messages += [problem.message] if problem.message not in messages else []
    joined = []
    for path, (first, *rest) in found.items():  # the first finding about a value, then what else it might have been
        head, bracket, meaning = first.partition(MEANING)
        others = [message.partition(" must be ")[2].partition(MEANING)[0] or message for message in rest]
        joined.append(Problem(path, " or ".join([head, *others]) + bracket + meaning))
    return joined


def key_name(path: Path) -> str:
    """The path as a person writes it: schedule.region[1].kc, counted from 1."""
    name = ""
    for part in path:
        name += f"[{part + 1}]" if isinstance(part, int) else f".{part}" if name else part
    return name


def _told(error: ErrorDetails, path: Path, document: Mapping[str, object]) -> Iterator[Problem]:
    """The problems behind one error: several when a check between settings found them, none when it only follows."""
    context: dict[str, Any] = error.get("ctx", {})
    cause = context.get("error")
    if isinstance(cause, CrossCheckError):
        for problem in cause.problems:
            yield Problem((*path, *problem.path), problem.message)
    elif error["type"] == "missing":
        yield Problem(path, "is missing; add it" + _meaning(path, document))
    elif error["type"] == "extra_forbidden":
        fields = [field for model in _models(path[:-1], document) for field in model.model_fields.items()]
        known = [field.alias or name for name, field in fields]
        close = difflib.get_close_matches(str(path[-1]), known, n=1)
        hint = f"did you mean {close[0]}?" if close else "known here: " + ", ".join(known)
        yield Problem(path, (f"is not a known key; {hint}"))
    elif error["type"] != "too_short" or len(error["input"]) < context["min_length"]:
        # an array counts as too short for pydantic when only its entries are wrong
        limit = LIMITS[error["type"]].format(**context) if error["type"] in LIMITS else f"is wrong: {error['msg']}"
        yield Problem(path, f"= {_value(error['input'])} {limit}{_meaning(path, document)}")


def _value(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        value = f'"{value}"'
    if isinstance(value, dict):
        return "{...}"
    shown = str(value) if not isinstance(value, int) or abs(value) < 10**LONGEST_VALUE else "a huge number"
    return shown if len(shown) <= LONGEST_VALUE else shown[: LONGEST_VALUE - 3] + "..."


def _meaning(path: Path, document: Mapping[str, object]) -> str:
    """What a setting is for, in brackets, of an element of an array what the array is for; empty for what is no
    declared setting.
    """
    while path and isinstance(path[-1], int):
        path = path[:-1]
    fields = [named for model in _models(path[:-1], document) for named in model.model_fields.items()] if path else []
    field = next((field for name, field in fields if path[-1] in _read_as(name, field)), None)
    if field is None:
        return ""
    unit = (field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}).get("unit")
    return f"{MEANING}{field.description}" + (f", in {unit})" if unit not in {None, "-", "1"} else ")")


def _read_as(name: str, field: FieldInfo) -> Sequence[object]:
    """The names under which a setting is read: its own, and former ones."""
    also = field.validation_alias
    return also.choices if isinstance(also, AliasChoices) else (field.alias or name,)


def _models(path: Path, document: Mapping[str, object]) -> list[type[Section]]:
    """The sections that may stand at a path: several only where a kind chooses and none is given."""
    models: list[type[Section]] = [Config]
    node: object = document
    for part in path:
        node = _inside(node, part)
        if isinstance(part, str):
            fields = [f for model in models for name, f in model.model_fields.items() if part in _read_as(name, f)]
            models = [inner for field in fields for inner in _sections(field.annotation)]
        kind = node.get("kind") if isinstance(node, Mapping) else None
        chosen = [m for m in models if "kind" in m.model_fields and kind in get_args(m.model_fields["kind"].annotation)]
        models = chosen or models
    return models


def _inside(node: object, part: str | int) -> object:
    if isinstance(node, Mapping):
        return node.get(part)
    if isinstance(node, list) and isinstance(part, int):
        return node[part]
    return None


def _sections(annotation: object) -> Iterator[type[Section]]:
    """The sections inside a type: itself, or members of its union, tuple or annotation."""
    if isinstance(annotation, type) and issubclass(annotation, Section):
        yield annotation
    for inner in get_args(annotation):
        yield from _sections(inner)


# ---- Configuration file to Config

# What would keep a session from its bus and can be seen without opening it: the interface's name, the key file.


def bus_problems(config: Config) -> Iterator[Problem]:
    """What is wrong with the bus that a configuration names, on this machine."""
    from retuner.drivers.bus.bus_opening import known_interfaces  # noqa: PLC0415  python-can, which is slow to load

    bus, known = config.bus, known_interfaces()
    if bus.interface not in known:
        message = f'= "{bus.interface}" is no interface of python-can; choose from {", ".join(known)}'
        yield Problem(("bus", "interface"), message)
    if bus.key_file:
        try:
            read_key(FilePath(bus.key_file))
        except KeyFileError as error:
            yield Problem(("bus", "key_file"), f"is refused: {error}")


# The signals on the bus that a configuration names: found in their DBC files, or by line and key what is wrong.


def signal_source(axis: AxisConfig, node: int) -> SignalSource | None:
    """Where an axis' variable comes from; None when it comes with the samples.

    Raises DbcError: the DBC cannot be read, or has no such message or signal.
    """
    if axis.variable != CAN:
        return None
    return find_signal(axis.dbc, axis.message, axis.signal, axis.stale_after_s, node)


def signal_problems(config: Config) -> Iterator[Problem]:
    """What is wrong with the signals that a configuration names."""
    for i, axis in enumerate(config.schedule.axis):
        try:
            signal_source(axis, config.bus.node)
        except DbcError as error:
            key = "signal" if "has no signal" in str(error) else "message" if "no message" in str(error) else "dbc"
            yield Problem(("schedule", "axis", i, key), f": {error}")


def device_problems(config: Config) -> Iterator[Problem]:
    """What is wrong with the description of a foreign device, and with the mapping onto it."""
    if config.foreign_device is None:
        return
    described = product("foreign device")
    try:
        described.held_table(config)
    except described.ProfileError as error:
        yield Problem(("device", *error.key), f": {error}")


LARGEST_FILE = 1 << 20  # bytes; a configuration of 64 regions and a thousand steps has a tenth of it
PLACE = re.compile(r" \(at (?:line (\d+), column (\d+)|end of document)\)$")


class ConfigFlaw(NamedTuple):
    """One problem with its place: line from 1, key as a person writes it (empty for the whole file), message."""

    line: int
    key: str
    message: str

    def text(self, file: str) -> str:
        """The one line that a person sees."""
        gap = " " * (bool(self.key) and not self.message.startswith(":"))
        return one_line(f"{file}:{self.line} {self.key}{gap}{self.message}")


class UnusableError(Exception):
    """A text that is no usable configuration; findings has every problem found."""

    def __init__(self, findings: list[ConfigFlaw]) -> None:
        self.findings = findings
        super().__init__(findings)


def load_config(path: str | FilePath, loop: str | None = None) -> Config:
    """Read and check a configuration file.

    Parameters
    ----------
    path : of the TOML file. loop : the name of one of several loops.

    Returns
    -------
    Config
        Every setting with its default; `gain_table()` and `regions()` give what the schedule needs.

    Raises
    ------
    ConfigError
        The file cannot be read or used; one line per problem.
    UserError
        There are several loops, and none or an unknown one is named.
    """
    session = load_session(path)[0]
    return session.loops[session.place(loop)]


def load_session(path: str | FilePath, *, as_run: bool = False) -> tuple[SessionConfig, str]:
    """Read and check a configuration file of one loop or several; the text that it was read from comes with it.

    as_run : a session has run it: the files that it names need not be here.

    Raises ConfigError: the file cannot be read or used; one line per problem.
    """
    try:
        text = read_text(path)
        session = parse_session(text)
        return session if as_run else with_signals(session, text), text
    except UnusableError as unusable:
        raise ConfigError(*(finding.text(str(path)) for finding in unusable.findings)) from None


def read_text(path: str | FilePath) -> str:
    """The text of a configuration file.

    Raises ConfigError: the file does not exist or cannot be opened.
    Raises UnusableError: it is too large, or not UTF-8.
    """
    file = FilePath(path)
    try:
        with file.open("rb") as stream:
            raw = stream.read(LARGEST_FILE + 1)
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file; `retuner init FILE` writes a starter configuration") from None
    except IsADirectoryError:
        raise ConfigError(f"{path}: is a folder; give the configuration file inside it") from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise ConfigError(f"{path}: cannot be read: {reason}") from None
    if len(raw) > LARGEST_FILE:
        raise UnusableError(
            [ConfigFlaw(1, "", f"the file is larger than {LARGEST_FILE} bytes; is it a configuration?")]
        )
    if raw.startswith(b"\xef\xbb\xbf"):
        raise UnusableError([ConfigFlaw(1, "", "starts with a byte order mark; save it as UTF-8 without one")])
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        message = f"byte 0x{raw[error.start]:02x} is not UTF-8; save the file as UTF-8"
        raise UnusableError([ConfigFlaw(line, "", message)]) from None


def parse_session(text: str) -> SessionConfig:
    """Check a configuration text.

    Raises UnusableError: with every problem found: of syntax the first, of settings all.
    """
    try:
        document = tomllib.loads(text)
    except RecursionError:
        raise UnusableError([ConfigFlaw(1, "", "brackets are nested too deeply; no setting needs that")]) from None
    except ValueError as error:
        message = str(error)
        place = PLACE.search(message)
        line = int(place[1]) if place and place[1] else text.rstrip().count("\n") + 1
        told = PLACE.sub("", message)
        told = told[:1].lower() + told[1:]
        column = f", column {place[2]}" if place and place[2] else ""
        raise UnusableError([ConfigFlaw(line, "", f"is not TOML: {told}{column}; correct the line")]) from None
    # Another schema gets one line about that, not fifty about its keys
    schema = document.get("schema")
    if type(schema) is int and schema != SCHEMA:
        line = toml_lines(text)[("schema",)]
        message = f"= {schema} is not known; this release reads schema {SCHEMA}; `retuner init` writes one"
        raise UnusableError([ConfigFlaw(line, "schema", message)])
    several = isinstance(document.get("loop"), list) and bool(document["loop"])
    documents = loop_documents(document) if several else [document]
    lines, loops, findings = toml_lines(text), [], []
    for i, one in enumerate(documents):
        try:
            loops.append(Config.model_validate(one))
        except ValidationError as error:
            problems = problems_of(error.errors(include_url=False), one)
            findings += [_placed(problem, lines, i if several else None) for problem in problems]
    _refuse_findings(findings)
    session = SessionConfig(tuple(loops), several)
    _refuse_findings([_placed(problem, lines, i) for i, problem in session.problems()])
    return session


def parse_config(text: str) -> Config:
    """Check a configuration text of one loop; errors as parse_session, and UserError when there are several."""
    session = parse_session(text)
    return session.loops[session.place(None)]


def with_signals(session: SessionConfig, text: str, *, bus: bool = False) -> SessionConfig:
    """The configuration, once the signals on the bus that it names have been found in their DBC files.

    bus : the bus's interface and the key file are looked for on this machine as well.

    Raises UnusableError: with everything that is not there.
    """
    looks = (signal_problems, device_problems, *((bus_problems,) if bus else ()))
    found = [(i, problem) for i, config in enumerate(session.loops) for look in looks for problem in look(config)]
    lines = toml_lines(text) if found else {}
    _refuse_findings([_placed(problem, lines, i if session.several else None) for i, problem in found])
    return session


def plants_here(session: SessionConfig, text: str) -> list[Sequence[str]]:
    """What the models behind the virtual devices say of themselves, a loop each, once they have been begun.

    Raises UnusableError: one cannot be begun.
    """
    behind = product("plants")
    with_plant = [i for i, one in enumerate(session.loops) if one.device is not None and one.device.plant is not None]
    try:
        with behind.Plants([session.loops[i] for i in with_plant], lambda _: None) as plants:
            told = dict(zip(with_plant, plants.begun(), strict=True))
    except behind.UnusablePlantError as error:
        loop = with_plant[error.loop] if session.several else None
        raise UnusableError([_placed(error.problem, toml_lines(text), loop)]) from None
    return [told.get(i, ()) for i in range(len(session.loops))]


def _refuse_findings(findings: Iterable[ConfigFlaw]) -> None:
    """Refuse a text in which something was found, each thing once, in the order of the file."""
    once = list(dict.fromkeys(findings))
    if once:
        raise UnusableError(sorted(once, key=lambda finding: finding.line))


def _placed(problem: Problem, lines: dict[Path, int], loop: int | None) -> ConfigFlaw:
    """The problem with the line of its key, or of the nearest table round it that is written down.

    loop : index of the [[loop]] that it is about; None in a file of one [loop].
    """
    key = path = problem.path if loop is None else written_at(problem.path, loop, lines)
    while path not in lines:
        path = path[:-1]
    return ConfigFlaw(lines[path], key_name(key), problem.message)


# A configuration as it was run: the whole text, with what the command line changed written into it.
#
# The text stays as its author wrote it; only the lines that were overridden change, and say so. Where a setting cannot
# be replaced on its line (an inline table, say), the settings in force are written out instead, without the comments.


def text_as_run(text: str, session: SessionConfig, changes: Mapping[tuple[str, str], str | bool]) -> str:
    """The text of a configuration with some settings changed, for all of its loops.

    text : as it was read. session : as it is run, with the changes. changes : (section, key) to its value.
    """
    for (section, key), value in changes.items():
        for i in range(len(session.loops)) if session.several else ():
            if ("loop", i, section, key) in toml_lines(text):
                text = _with_setting(text, ("loop", i, section), key, value)
        text = _with_setting(text, (section,), key, value)
    try:
        same = parse_session(text) == session
    except UnusableError:
        same = False
    return text if same else written_out(session)


def _with_setting(text: str, table: Path, key: str, value: str | bool) -> str:
    """The text with one setting replaced on its line, or put under its section's header, or at the end."""
    places = toml_lines(text)
    lines = text.split("\n")
    setting = f"{key} = {json.dumps(value)}"
    section = table[-1]
    if (*table, key) in places:
        at = places[(*table, key)] - 1
        lines[at] = f"{setting}  # by the command line; the file says: {lines[at].strip()}"
    elif table in places and re.match(rf"\s*\[\s*{section}\s*\]", lines[places[table] - 1]):
        lines.insert(places[table], f"{setting}  # by the command line")
    else:
        lines += [f"[{section}]", f"{setting}  # by the command line", ""]
    return "\n".join(lines)


def written_out(session: SessionConfig) -> str:
    """All settings in force as TOML, a line each, tables inside a section inline."""
    documents = [config.model_dump(mode="json", by_alias=True, exclude_none=True) for config in session.loops]
    if not session.several:
        return _tables(documents[0], "[{}]")
    top = {name: documents[0][name] for name in ("schema", "output")}
    loops = [{**one.pop("loop"), **{k: v for k, v in one.items() if k not in top}} for one in documents]
    return "\n".join((_tables(top, "[{}]"), *("[[loop]]\n" + _tables(one, "[loop.{}]") for one in loops)))


def _tables(settings: Mapping[str, object], header: str) -> str:
    plain = {name: value for name, value in settings.items() if not isinstance(value, dict)}
    tables = {name: value for name, value in settings.items() if isinstance(value, dict)}
    parts = ["\n".join(f"{name} = {_toml(value)}" for name, value in plain.items())]
    parts += [
        "\n".join((header.format(name), *(f"{key} = {_toml(value)}" for key, value in table.items())))
        for name, table in tables.items()
    ]
    return "\n\n".join(parts) + "\n"


def _toml(value: object) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(inner)}" for key, inner in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value)
