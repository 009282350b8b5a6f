"""pydantic's findings in this project's words: key, what is wrong, the limit, what to do."""

import difflib
from collections.abc import Iterator, Mapping
from typing import Any, get_args

from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from retuner.config.model import Config
from retuner.config.setting import CrossCheckError, Problem, Section
from retuner.config.toml_lines import Path

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
            if problem.message not in messages:
                messages.append(problem.message)
    return [Problem(path, _joined(messages)) for path, messages in found.items()]


def key_name(path: Path) -> str:
    """The path as a person writes it: schedule.region[1].kc, counted from 1."""
    name = ""
    for part in path:
        name += f"[{part + 1}]" if isinstance(part, int) else f".{part}" if name else part
    return name


def _joined(messages: list[str]) -> str:
    """Findings about one value: the first, then what else it might have been."""
    first, *rest = messages
    head, bracket, meaning = first.partition(MEANING)
    alternatives = [message.partition(" must be ")[2].partition(MEANING)[0] or message for message in rest]
    return " or ".join([head, *alternatives]) + bracket + meaning


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
        known = [name for model in _models(path[:-1], document) for name in _names(model)]
        close = difflib.get_close_matches(str(path[-1]), known, n=1)
        hint = f"did you mean {close[0]}?" if close else "known here: " + ", ".join(known)
        yield Problem(path, (f"is not a known key; {hint}"))
    elif error["type"] != "too_short" or len(error["input"]) < context["min_length"]:
        # an array counts as too short for pydantic when only its entries are wrong
        limit = LIMITS[error["type"]].format(**context) if error["type"] in LIMITS else f"is wrong: {error['msg']}"
        yield Problem(path, f"= {_value(error['input'])} {limit}{_meaning(path, document)}")


def _value(value: object) -> str:
    """A value as TOML writes it, cut when long."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        value = f'"{value}"'
    if isinstance(value, dict):
        return "{...}"
    shown = str(value) if not isinstance(value, int) or abs(value) < 10**LONGEST_VALUE else "a huge number"
    return shown if len(shown) <= LONGEST_VALUE else shown[: LONGEST_VALUE - 3] + "..."


def _meaning(path: Path, document: Mapping[str, object]) -> str:
    """What a setting is for, in brackets; empty for what is no declared setting."""
    field = _field(path, document)
    if field is None:
        return ""
    extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
    unit = extra.get("unit")
    return f"{MEANING}{field.description}" + (f", in {unit})" if unit not in {None, "-", "1"} else ")")


def _names(model: type[Section]) -> list[str]:
    return [field.alias or name for name, field in model.model_fields.items()]


def _field(path: Path, document: Mapping[str, object]) -> FieldInfo | None:
    """The declaration of a setting; for an element of an array that of the array."""
    while path and isinstance(path[-1], int):
        path = path[:-1]
    for model in _models(path[:-1], document) if path else []:
        for name, field in model.model_fields.items():
            if path[-1] == (field.alias or name):
                return field
    return None


def _models(path: Path, document: Mapping[str, object]) -> list[type[Section]]:
    """The sections that may stand at a path: several only where a kind chooses and none is given."""
    models: list[type[Section]] = [Config]
    node: object = document
    for part in path:
        node = _inside(node, part)
        if isinstance(part, str):
            fields = [f for model in models for name, f in model.model_fields.items() if part == (f.alias or name)]
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
