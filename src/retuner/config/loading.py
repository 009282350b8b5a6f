"""Configuration file to Config, and every problem of a file as one line each: file:line key what, limit, what to do."""

import json
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path as FilePath
from typing import NamedTuple

from pydantic import ValidationError

from retuner.config.messages import key_name, problems_of
from retuner.config.model import SCHEMA, Config
from retuner.config.schedule import AxisConfig
from retuner.config.session_config import SessionConfig, loop_documents, written_at
from retuner.config.setting import Problem
from retuner.config.toml_lines import Path, toml_lines
from retuner.drivers.host.key_file import KeyFileError, read_key
from retuner.drivers.protocol.codec import DbcError
from retuner.drivers.telemetry.signal_source import SignalSource, find_signal
from retuner.errors import ConfigError, one_line
from retuner.products import product
from retuner.schedule.axis import CAN

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

    Raises
    ------
    DbcError
        The DBC cannot be read, or has no such message or signal.
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
        return one_line(f"{file}:{self.line} {self.key + ' ' if self.key else ''}{self.message}")


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


def load_session(path: str | FilePath) -> tuple[SessionConfig, str]:
    """Read and check a configuration file of one loop or several; the text that it was read from comes with it.

    Raises
    ------
    ConfigError
        The file cannot be read or used; one line per problem.
    """
    try:
        text = read_text(path)
        return with_signals(parse_session(text), text), text
    except UnusableError as unusable:
        raise ConfigError(*(finding.text(str(path)) for finding in unusable.findings)) from None


def read_text(path: str | FilePath) -> str:
    """The text of a configuration file.

    Raises
    ------
    ConfigError
        The file does not exist or cannot be opened.
    UnusableError
        It is too large, or not UTF-8.
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

    Raises
    ------
    UnusableError
        With every problem found: of syntax the first, of settings all.
    """
    document = _parsed(text)
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


def with_signals(session: SessionConfig, text: str) -> SessionConfig:
    """The configuration, once the signals on the bus that it names have been found in their DBC files.

    Raises
    ------
    UnusableError
        With every signal that is not there.
    """
    return _with(session, text, signal_problems, device_problems)


def usable_here(session: SessionConfig, text: str) -> SessionConfig:
    """The configuration, once what it names is on this machine: signals, the bus's interface, the key file.

    Raises
    ------
    UnusableError
        With everything that is not.
    """
    return _with(session, text, signal_problems, device_problems, bus_problems)


def plants_here(session: SessionConfig, text: str) -> list[Sequence[str]]:
    """What the models behind the virtual devices say of themselves, a loop each, once they have been begun.

    Raises
    ------
    UnusableError
        One cannot be begun.
    """
    behind = product("plants")
    with_plant = [i for i, one in enumerate(session.loops) if one.device is not None and one.device.plant is not None]
    try:
        with behind.Plants([session.loops[i] for i in with_plant], lambda _: None) as plants:
            told = dict(zip(with_plant, plants.described, strict=True))
    except behind.UnusablePlantError as error:
        loop = with_plant[error.loop] if session.several else None
        raise UnusableError([_placed(error.problem, toml_lines(text), loop)]) from None
    return [told.get(i, ()) for i in range(len(session.loops))]


def _with(session: SessionConfig, text: str, *looks: Callable[[Config], Iterable[Problem]]) -> SessionConfig:
    """The configuration, once these have found nothing wrong with any of its loops."""
    found = [(i, problem) for i, config in enumerate(session.loops) for look in looks for problem in look(config)]
    lines = toml_lines(text) if found else {}
    _refuse_findings([_placed(problem, lines, i if session.several else None) for i, problem in found])
    return session


def _refuse_findings(findings: Iterable[ConfigFlaw]) -> None:
    """Refuse a text in which something was found, each thing once, in the order of the file."""
    once = list(dict.fromkeys(findings))
    if once:
        raise UnusableError(sorted(once, key=lambda finding: finding.line))


def _parsed(text: str) -> dict[str, object]:
    try:
        return tomllib.loads(text)
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

    Parameters
    ----------
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
    """Settings and one level of tables; header : of a table, with a place for its name."""
    plain = {name: value for name, value in settings.items() if not isinstance(value, dict)}
    tables = {name: value for name, value in settings.items() if isinstance(value, dict)}
    parts = ["\n".join(f"{name} = {_toml(value)}" for name, value in plain.items())]
    parts += [
        "\n".join((header.format(name), *(f"{key} = {_toml(value)}" for key, value in table.items())))
        for name, table in tables.items()
    ]
    return "\n\n".join(parts) + "\n"


def _toml(value: object) -> str:
    """A JSON value as TOML has it, on one line."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(inner)}" for key, inner in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value)
