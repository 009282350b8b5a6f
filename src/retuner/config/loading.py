"""Configuration file to Config, and every problem of a file as one line each: file:line key what, limit, what to do."""

import re
import tomllib
from collections.abc import Iterable
from pathlib import Path as FilePath
from typing import NamedTuple

from pydantic import ValidationError

from retuner.config.bus_problems import bus_problems
from retuner.config.messages import key_name, problems_of
from retuner.config.model import SCHEMA, Config
from retuner.config.setting import Problem
from retuner.config.signals import signal_problems
from retuner.config.toml_lines import Path, toml_lines
from retuner.errors import ConfigError, one_line

LARGEST_FILE = 1 << 20  # bytes; a configuration of 64 regions and a thousand steps has a tenth of it
PLACE = re.compile(r" \(at (?:line (\d+), column (\d+)|end of document)\)$")


class Finding(NamedTuple):
    """One problem with its place: line from 1, key as a person writes it (empty for the whole file), message."""

    line: int
    key: str
    message: str

    def text(self, file: str) -> str:
        """The one line that a person sees."""
        return one_line(f"{file}:{self.line} {self.key + ' ' if self.key else ''}{self.message}")


class UnusableError(Exception):
    """A text that is no usable configuration; findings has every problem found."""

    def __init__(self, findings: list[Finding]) -> None:
        self.findings = findings
        super().__init__(findings)


def load_config(path: str | FilePath) -> Config:
    """Read and check a configuration file; errors as load_with_text."""
    return load_with_text(path)[0]


def load_with_text(path: str | FilePath) -> tuple[Config, str]:
    """Read and check a configuration file; the configuration and the text that it was read from.

    Raises
    ------
    ConfigError
        The file cannot be read or used; one line per problem.
    """
    try:
        text = read_text(path)
        return with_signals(parse_config(text), text), text
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
        raise UnusableError([Finding(1, "", f"the file is larger than {LARGEST_FILE} bytes; is it a configuration?")])
    if raw.startswith(b"\xef\xbb\xbf"):
        raise UnusableError([Finding(1, "", "starts with a byte order mark; save it as UTF-8 without one")])
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        message = f"byte 0x{raw[error.start]:02x} is not UTF-8; save the file as UTF-8"
        raise UnusableError([Finding(line, "", message)]) from None


def parse_config(text: str) -> Config:
    """Check a configuration text.

    Raises
    ------
    UnusableError
        With every problem found: of syntax the first, of settings all.
    """
    document = _parsed(text)
    _check_schema(document, text)
    try:
        return Config.model_validate(document)
    except ValidationError as error:
        problems = problems_of(error.errors(include_url=False), document)
    lines = toml_lines(text)
    raise UnusableError(sorted((_placed(problem, lines) for problem in problems), key=lambda finding: finding.line))


def with_signals(config: Config, text: str) -> Config:
    """The configuration, once the signals on the bus that it names have been found in their DBC files.

    Raises
    ------
    UnusableError
        With every signal that is not there.
    """
    _refuse(signal_problems(config), text)
    return config


def usable_here(config: Config, text: str) -> Config:
    """The configuration, once what it names is on this machine: signals, the bus's interface, the key file.

    Raises
    ------
    UnusableError
        With everything that is not.
    """
    _refuse((*signal_problems(config), *bus_problems(config)), text)
    return config


def _refuse(problems: Iterable[Problem], text: str) -> None:
    """Refuse a text with these problems, if there are any."""
    lines = toml_lines(text)
    findings = [_placed(problem, lines) for problem in problems]
    if findings:
        raise UnusableError(sorted(findings, key=lambda finding: finding.line))


def _parsed(text: str) -> dict[str, object]:
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise UnusableError([Finding(1, "", "brackets are nested too deeply; no setting needs that")]) from None
    except ValueError as error:
        message = str(error)
        place = PLACE.search(message)
        line = int(place[1]) if place and place[1] else text.rstrip().count("\n") + 1
        told = PLACE.sub("", message)
        told = told[:1].lower() + told[1:]
        column = f", column {place[2]}" if place and place[2] else ""
        raise UnusableError([Finding(line, "", f"is not TOML: {told}{column}; correct the line")]) from None


def _check_schema(document: dict[str, object], text: str) -> None:
    """Another schema gets one line about that, not fifty about its keys."""
    schema = document.get("schema")
    if type(schema) is int and schema != SCHEMA:
        line = toml_lines(text)[("schema",)]
        message = f"= {schema} is not known; this release reads schema {SCHEMA}; `retuner init` writes one"
        raise UnusableError([Finding(line, "schema", message)])


def _placed(problem: Problem, lines: dict[Path, int]) -> Finding:
    """The problem with the line of its key, or of the nearest table round it that is written down."""
    path = problem.path
    while path not in lines:
        path = path[:-1]
    return Finding(lines[path], key_name(problem.path), problem.message)
