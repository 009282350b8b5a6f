"""What every section of the configuration shares: how a setting is declared, how problems between settings are told.

A declared setting carries its meaning, unit, range, default and the source of the default, so that `retuner check`,
the reference page and a reader of the code see the same.
"""

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from types import MappingProxyType
from typing import Annotated, Any, TypeVar

from pydantic import AliasChoices, BaseModel, ConfigDict, Field, Strict, create_model, model_validator
from pydantic_core import PydanticUndefined

from retuner.adaptive.declared_setting import SettingLimits, declared
from retuner.config.toml_lines import Path
from retuner.schedule.late_dataclass import dataclass

T = TypeVar("T")
Many = Annotated[tuple[T, ...], Strict(strict=False)]  # a TOML array; its elements stay strict


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing wrong: the path of the key below the section that found it, and what is wrong, limit, what to do."""

    path: Path
    message: str


class CrossCheckError(ValueError):
    """Settings that are each in range but do not go together."""

    def __init__(self, problems: list[Problem]) -> None:
        self.problems = problems
        super().__init__("; ".join(problem.message for problem in problems))


class Section(BaseModel):
    """A table of the file: frozen, every key known, numbers finite and never true or false."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)

    @model_validator(mode="after")
    def _settings_go_together(self) -> "Section":
        problems = list[Problem]()
        for name in type(self).model_fields:
            # characters that a terminal would act on: texts are shown, and stand in reports and ledgers
            value = getattr(self, name)
            for text in value if isinstance(value, tuple) else (value,):
                if isinstance(text, str) and not text.isprintable():
                    told = f"= {text!r} has characters that cannot be printed; leave them out"
                    problems.append(Problem((name,), told))
        if problems := [*problems, *self.problems()]:
            raise CrossCheckError(problems)
        return self

    def problems(self) -> Iterator[Problem]:
        """What is wrong between the settings of this section; sections override it."""
        yield from ()


def setting(
    meaning: str,
    limits: str = "-",
    default: object = PydanticUndefined,
    source: str = "the user",
    *,
    alias: str | None = None,
    names: tuple[str, ...] = (),
) -> Any:  # noqa: ANN401  the type of a pydantic field default is the field's own
    """Declare a setting.

    meaning : what it does, one sentence without a full stop.
    limits : and its unit, as in "0..1e9 s": "pv" is the loop's own unit, "1" for ratios; or "1..64 characters",
    "0..2 entries", "0..2 entries in s" of a text or a list. Without a unit it is a name or a choice.
    default : value when the key is missing; without one the key must be given.
    source : where the default or the limit comes from.
    alias : its name in the file, where Python keeps the field's for itself.
    names : under which the file may have it, where that is more than one: the field's own, then former ones.
    """
    low, high, above, below, unit = SettingLimits.of(limits)
    counted, _, unit = unit.partition(" in ") if unit.startswith(COUNTED) else ("", "", unit)
    least, most = (low if math.isfinite(low) else None), (high if math.isfinite(high) else None)
    ends: Any = {"min_length" if counted else "gt" if above else "ge": least}
    ends["max_length" if counted else "lt" if below else "le"] = most
    return Field(
        default=default,
        description=meaning,
        **ends,
        alias=alias,
        validation_alias=AliasChoices(*names) if names else alias,
        json_schema_extra={"unit": unit or "-", "source": source},
    )


COUNTED = ("characters", "entries")
AnySection = TypeVar("AnySection", bound=Section)
ALL: Mapping[str, dict[str, Any]] = MappingProxyType({})
GREATEST = 1e9  # What a setting that is a positive number without a limit may be in the file


def holding(
    settings: type, prefix: str = "", but: Collection[str] = (), narrower: Mapping[str, dict[str, Any]] = ALL
) -> Callable[[type[AnySection]], type[AnySection]]:
    """Give a section the settings of a dataclass that belong into the file: those that are declared with a source.

    A section that has a few of them names these, with or without the prefix, by their type alone; else all are its own
    without those of `but`. narrower : the limits of what the file lets a person set less far than the program does.
    """

    def filled(section: type[AnySection]) -> type[AnySection]:
        """The section with its settings; statically it stays what it was."""
        bare = {name for name, field in section.model_fields.items() if field.description is None}
        given: Any = {}
        for one in declared(settings):
            named = next((name for name in (prefix + one.name, one.name) if name in bare), "" if bare else one.name)
            if one.setting.source and named and one.name not in but:
                s = one.setting._replace(**narrower.get(one.name, {}))
                positive, high = (True, GREATEST) if s.low == 0 and s.high == math.inf else (s.positive, s.high)
                limits, default = f"{'>' * positive}{s.low}..{high} {s.unit}", None if s.absent else one.default
                field = setting(s.meaning, limits, default, s.source)
                given[named] = (one.type | None if s.absent else one.type), field
        return create_model(section.__name__, __base__=section, __doc__=section.__doc__, **given)

    return filled


def held_by(section: Section, settings: type, prefix: str = "") -> dict[str, Any]:
    """What a section says of the settings of a dataclass, by their names there; what is absent is left to it."""
    found = {
        one.name: getattr(section, prefix + one.name, getattr(section, one.name, None)) for one in declared(settings)
    }
    return {name: value for name, value in found.items() if value is not None}
