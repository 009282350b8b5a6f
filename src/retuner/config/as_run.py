"""A configuration as it was run: the whole text, with what the command line changed written into it.

The text stays as its author wrote it; only the lines that were overridden change, and say so. Where a setting cannot be
replaced on its line (an inline table, say), the settings in force are written out instead, without the comments.
"""

import json
import re
from collections.abc import Mapping

from retuner.config.loading import UnusableError, parse_config
from retuner.config.model import Config
from retuner.config.toml_lines import toml_lines


def text_as_run(text: str, config: Config, changes: Mapping[tuple[str, str], str | bool]) -> str:
    """The text of a configuration with some settings changed.

    Parameters
    ----------
    text : as it was read. config : as it is run, with the changes. changes : (section, key) to its value.
    """
    for (section, key), value in changes.items():
        text = _with_setting(text, section, key, value)
    try:
        same = parse_config(text) == config
    except UnusableError:
        same = False
    return text if same else written_out(config)


def _with_setting(text: str, section: str, key: str, value: str | bool) -> str:
    """The text with one setting replaced on its line, or put under its section's header, or at the end."""
    places = toml_lines(text)
    lines = text.split("\n")
    setting = f"{key} = {json.dumps(value)}"
    if (section, key) in places:
        at = places[section, key] - 1
        lines[at] = f"{setting}  # by the command line; the file says: {lines[at].strip()}"
    elif (section,) in places and re.match(rf"\s*\[\s*{section}\s*\]", lines[places[(section,)] - 1]):
        lines.insert(places[(section,)], f"{setting}  # by the command line")
    else:
        lines += [f"[{section}]", f"{setting}  # by the command line", ""]
    return "\n".join(lines)


def written_out(config: Config) -> str:
    """All settings in force as TOML, a line each, tables inside a section inline."""
    settings = config.model_dump(mode="json", by_alias=True, exclude_none=True)
    plain = {name: value for name, value in settings.items() if not isinstance(value, dict)}
    tables = {name: value for name, value in settings.items() if isinstance(value, dict)}
    parts = ["\n".join(f"{name} = {_toml(value)}" for name, value in plain.items())]
    parts += [
        "\n".join((f"[{name}]", *(f"{key} = {_toml(value)}" for key, value in table.items())))
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
