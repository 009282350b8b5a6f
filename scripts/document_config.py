"""Write docs/configuration.md: every setting with its meaning, unit, range, default and source, from the models.

python scripts/document_config.py
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Literal, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from retuner.config.model import Config
from retuner.config.setting import Section

PAGE = Path(__file__).resolve().parent.parent / "docs" / "configuration.md"
HEAD = """# Configuration

One TOML file describes one loop, or [several](several-loops.md) as `[[loop]]` tables with the same keys. `retuner
init FILE` writes a commented one, `retuner check FILE` names file, line, key and limit of everything that is wrong.
Numbers must be finite; a key that is not listed here is refused. Unit "pv" is the loop's own engineering unit. This
page is written by scripts/document_config.py.
"""


def page() -> str:
    """The page as Markdown."""
    return HEAD + "".join(section(Config, "top of the file"))


def section(model: type[Section], title: str) -> Iterator[str]:
    """A table of the plain settings of a section, then the sections inside it."""
    inner: list[tuple[type[Section], str]] = []
    rows = []
    for name, field in model.model_fields.items():
        key = field.alias or name
        sections = list(sections_in(field.annotation))
        if sections:
            inner += [(found, heading(title, key, found, field)) for found in sections]
        else:
            rows.append(row(key, field))
    first = str(model.__doc__).rpartition("]: ")[2].partition(": ")
    sentence = (first[2] or first[0]) if "kind =" in first[0] else "".join(first)
    sentence = sentence[:1].upper() + sentence[1:]
    yield f"\n## {title}\n\n{sentence}\n"
    if rows:
        yield "\n| key | meaning | unit | range | default | source |\n|---|---|---|---|---|---|\n" + "".join(rows)
    for found, deeper in inner:
        yield from section(found, deeper)


def heading(title: str, key: str, found: type[Section], field: FieldInfo) -> str:
    """The section's name as it stands in the file."""
    place, _, under = title.partition(", in ")
    under = place if " with kind" in place else under
    outer = "" if title.startswith("top") else place.partition("` ")[0].strip("[]`") + "."
    kind = found.model_fields.get("kind")
    several = len(list(sections_in(field.annotation))) > 1 and kind is not None
    many = get_origin(field.annotation) is tuple
    name = f"`[[{outer}{key}]]`" if many else f"`[{outer}{key}]`"
    name += f' with kind = "{get_args(kind.annotation)[0]}"' if several and kind is not None else ""
    return f"{name}, in {under}" if under else name


def row(key: str, field: FieldInfo) -> str:
    """One line of the table."""
    extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
    default = "required" if field.default is PydanticUndefined else shown(field.default)
    cells = [f"`{key}`", str(field.description), str(extra["unit"]), limits(field), default, str(extra["source"])]
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"


def shown(value: object) -> str:
    """A default as TOML writes it."""
    if value is None:
        return "absent"
    if value == ():
        return "`[]`"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    return f'`"{value}"`' if isinstance(value, str) else f"`{value:g}`" if isinstance(value, float) else f"`{value}`"


def limits(field: FieldInfo) -> str:
    """The range, or the choices, in words."""
    found = {type(limit): words(limit) for limit in [*field.metadata, *limits_inside(field.annotation)]}
    ends = " to ".join([found.pop(Ge), found.pop(Le)]) if {Ge, Le} <= set(found) else ""
    choices = [f'"{choice}"' if isinstance(choice, str) else str(choice) for choice in choices_of(field.annotation)]
    numbers = " to ".join(filter(None, [ends, *found.values()]))
    return " or ".join(filter(None, [numbers, ", ".join(choices)]))


def words(limit: object) -> str:
    """One limit in words."""
    match limit:
        case Ge(ge=value):
            return f"{value:g}"
        case Gt(gt=value):
            return f"above {value:g}"
        case Le(le=value):
            return f"{value:g}"
        case Lt(lt=value):
            return f"below {value:g}"
        case _:
            return ""


def limits_inside(annotation: object) -> Iterator[object]:
    """Limits that stand on a member of a union or on the elements of an array."""
    for limit in getattr(annotation, "__metadata__", ()):
        yield from limit.metadata if isinstance(limit, FieldInfo) else [limit]
    for inner in get_args(annotation):
        yield from limits_inside(inner)


def choices_of(annotation: object) -> Iterator[object]:
    """The values of every Literal in a type."""
    if get_origin(annotation) is Literal:
        yield from get_args(annotation)
    else:
        for inner in get_args(annotation):
            yield from choices_of(inner)


def sections_in(annotation: object) -> Iterator[type[Section]]:
    """The sections in a type."""
    if isinstance(annotation, type) and issubclass(annotation, Section):
        yield annotation
    for inner in get_args(annotation):
        yield from sections_in(inner)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
