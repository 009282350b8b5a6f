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
from retuner.config.section import Section

PAGE = Path(__file__).resolve().parent.parent / "docs" / "configuration.md"
HEAD = """# Configuration

One TOML file describes one loop, or [several](several-loops.md) as `[[loop]]` tables with the same keys. `retuner
init FILE` writes a commented one, `retuner check FILE` names file, line, key and limit of everything that is wrong.
Numbers must be finite; a key that is not listed here is refused. Unit "pv" is the loop's own engineering unit. The
source says where a default comes from; without one it is yours to choose. scripts/document_config.py writes this page.
"""
YOURS = {"the user", "user", "the plant", "plant", "this release"}
ALIKE = 3
"""From so many rows on that stand in another section too, they are named and not told again."""


def page() -> str:
    """The page as Markdown: each kind of section once, with all places where it stands."""
    places: dict[type[Section], list[str]] = {}
    gather(Config, "top of the file", places)
    told: dict[str, str] = {}
    return HEAD + "".join(section(model, titles, told) for model, titles in places.items())


def gather(model: type[Section], title: str, places: dict[type[Section], list[str]]) -> None:
    """Note where a section and those inside it stand."""
    known = model in places
    places.setdefault(model, []).append(title)
    if known:
        return
    for name, field in model.model_fields.items():
        for found in sections_in(field.annotation):
            gather(found, heading(title, field.alias or name, found, field), places)


def section(model: type[Section], titles: list[str], told: dict[str, str]) -> str:
    """The plain settings of a section as a table, without those that another section has told."""
    plain = [(field.alias or name, field) for name, field in model.model_fields.items()]
    rows = [row(key, field) for key, field in plain if not list(sections_in(field.annotation))]
    before = [line for line in rows if line in told]
    alike = ""
    if len(before) >= ALIKE and len({told[line] for line in before}) == 1:
        rows = [line for line in rows if line not in told]
        keys = ", ".join(line.split(" | ")[0].removeprefix("| ") for line in before)
        alike = f" As in {told[before[0]]}: {keys}."
    for line in rows:
        told.setdefault(line, titles[0])
    first = str(model.__doc__).rpartition("]: ")[2].partition(": ")
    sentence = (first[2] or first[0]) if "kind =" in first[0] else "".join(first)
    sentence = sentence[:1].upper() + sentence[1:]
    others = list(dict.fromkeys(title.partition(", in `")[0] for title in titles[1:]))
    also = f" Also {', '.join(others)}." if others and others[0] not in titles[0] else ""
    table = "\n| key | meaning | range | default | source |\n|---|---|---|---|---|\n" + "".join(rows) if rows else ""
    return f"\n## {titles[0]}\n\n{sentence}{also}{alike}\n{table}"


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
    unit, source = str(extra["unit"]), str(extra["source"])
    ranged = " ".join(filter(None, [limits(field), "" if unit in {"-", "1"} else unit]))
    cells = [f"`{key}`", str(field.description), ranged, default, "" if source in YOURS else source]
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
