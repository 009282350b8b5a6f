"""`dataclass` for frozen classes with slots: the methods are made when the first object is, not when the class is.

`dataclasses` compiles six methods a class, half a millisecond: of two hundred classes two thirds of what importing
Retuner cost beside numpy. It makes them here too, later: same signatures, errors, fields and pickles.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import InitVar, asdict, astuple, field, fields, replace
from types import MethodType
from typing import TYPE_CHECKING, Any, ClassVar

__all__ = ["InitVar", "asdict", "astuple", "dataclass", "field", "fields", "replace"]

DATA = ("__dataclass_fields__", "__match_args__")
USED = (*DATA, "__setstate__", "__getstate__", "__delattr__", "__setattr__", "__init__")
SHOWN = ("__dataclass_params__", "__hash__", "__eq__", "__repr__")
METHODS = {*USED, *SHOWN} - {*DATA, "__dataclass_params__"}
"""What `dataclasses` gives a class: what nearly every object needs (__init__ last: who finds it finds all), and what
few are asked for.
"""


class _WhenRead:
    """A part of a class that is there once it is asked for; a method is bound to whom it is asked of."""

    def __init__(self, name: str, complete: Callable[[str], Any]) -> None:
        self.name, self.complete = name, complete

    def __get__(self, of: object, _: type) -> object:
        found = getattr(self.complete(self.name), self.name)
        return found if of is None or self.name not in METHODS else MethodType(found, of)


def _late(defined: type, options: dict[str, bool]) -> Any:  # noqa: ANN401
    """The class with its slots, what is made of them to come. Two threads may both make it: the parts are the same."""
    body = {name: value for name, value in vars(defined).items() if name not in {"__dict__", "__weakref__"}}
    body |= {"__qualname__": defined.__qualname__, "__doc__": defined.__doc__ or defined.__name__}

    def complete(name: str) -> Any:  # noqa: ANN401  a class whose parts no checker knows
        shown = name in SHOWN
        of = type(defined)(defined.__name__, defined.__bases__, dict(body))
        parts = vars(dataclasses.dataclass(**options, eq=shown, repr=shown)(of))
        # Python 3.13 gives __replace__ besides; a slot has no underscores in front
        further = {each for each in parts.keys() - vars(late).keys() if each.startswith("__")}
        for each in (*further, *(each for each in (SHOWN if shown else USED) if each not in body)):
            setattr(late, each, parts[each])
        late.__signature__ = None  # that of __init__, inspect takes this for
        return late

    notes = {name: getattr(kind, "__origin__", kind) for name, kind in defined.__annotations__.items()}
    own = [name for name, kind in notes.items() if kind is not ClassVar and type(kind) is not InitVar]
    above = {name for base in defined.__mro__[1:-1] for name in getattr(base, "__slots__", ())}
    space: dict[str, object] = {name: _WhenRead(name, complete) for name in (*USED, *SHOWN, "__signature__")}
    space |= {name: value for name, value in body.items() if name not in own}
    space["__slots__"] = tuple(name for name in own if name not in above)
    late: Any = type(defined)(defined.__name__, defined.__bases__, space)
    return late


if TYPE_CHECKING:
    from dataclasses import dataclass
else:

    def dataclass(cls: type | None = None, /, **options: bool) -> Callable[[type], type] | type:
        """dataclasses.dataclass, late where the class is frozen and has slots."""
        late = options.get("frozen") and options.get("slots") and options.keys() <= {"frozen", "slots", "kw_only"}
        return (lambda defined: _late(defined, options)) if late else dataclasses.dataclass(cls, **options)
