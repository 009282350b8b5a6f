"""`dataclass` for frozen classes: the methods are made when the first object is, not when the class is.

`dataclasses` compiles six methods a class, half a millisecond: of two hundred classes two thirds of what importing
Retuner cost beside numpy. What an object needs is made here with the first one, in a fifth of that; what compares and
shows is made by `dataclasses`, once it is asked for. Signatures, errors, fields and pickles are the same.
"""

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, FrozenInstanceError, InitVar, asdict, astuple, field, fields, replace
from types import MemberDescriptorType, MethodType
from typing import TYPE_CHECKING, Any, ClassVar

__all__ = ["InitVar", "asdict", "astuple", "dataclass", "field", "fields", "replace"]

DATA = ("__dataclass_fields__", "__match_args__", "__signature__", "__dataclass_params__")
USED = (*DATA[:3], "__setstate__", "__getstate__", "__delattr__", "__setattr__", "__init__")
SHOWN = (*DATA[3:], "__hash__", "__eq__", "__repr__")
"""What `dataclasses` gives a class: what nearly every object needs (__init__ last: who finds it finds all), and what
few are asked for. DATA are not methods.
"""


class _Factory:
    """Stands for what was not given, where a factory makes it."""

    def __repr__(self) -> str:
        return "<factory>"


class _WhenRead:
    """A part of a class that is there once it is asked for; a method is bound to whom it is asked of."""

    def __init__(self, name: str, complete: Callable[[str], Any]) -> None:
        self.name, self.complete = name, complete

    def __get__(self, of: object, _: type) -> object:
        found = getattr(self.complete(self.name), self.name)
        return found if of is None or self.name in DATA else MethodType(found, of)


def _initializer(late: Any, given: list["Field[Any]"]) -> Any:  # noqa: ANN401  a class whose parts no checker knows
    """`__init__` of a class with these fields, each put straight into its slot."""
    known: dict[str, object] = {"_set": object.__setattr__, "_not_given": _Factory(), "__name__": late.__module__}
    in_order, by_name, lines, after = ["self"], ["*"], list[str](), list[str]()
    for each in given:
        name, usual, value = each.name, "", each.name if each.init else ""
        if each.default_factory is not MISSING:
            known[f"_make_{name}"], usual = each.default_factory, "=_not_given"
            value = f"_make_{name}()" + (f" if {name} is _not_given else {name}" if each.init else "")
        elif each.default is not MISSING:
            known[f"_usual_{name}"], usual = each.default, f"=_usual_{name}"
            value = value or f"_usual_{name}"
        if each.init:
            (by_name if each.kw_only else in_order).append(name + usual)
        if type(each.type) is InitVar:
            after.append(name)
        elif value and isinstance(slot := getattr(late, name, None), MemberDescriptorType):
            known[f"_into_{name}"] = slot.__set__
            lines.append(f"_into_{name}(self, {value})")
        elif value:
            lines.append(f"_set(self, {name!r}, {value})")
    lines += [f"self.__post_init__({', '.join(after)})"] if hasattr(late, "__post_init__") else []
    told = ", ".join(in_order + by_name * (len(by_name) > 1))
    exec(f"def __init__({told}): {'; '.join(lines) or 'pass'}", known)  # noqa: S102  as `dataclasses` does
    made: Any = known["__init__"]
    made.__qualname__ = f"{late.__qualname__}.__init__"
    made.__annotations__ = {each.name: each.type for each in given if each.init} | {"return": None}
    return made


def _frozen(late: Any, names: tuple[str, ...]) -> dict[str, object]:  # noqa: ANN401
    """What holds an object as it was made, and takes it through a pickle."""

    def held(self: object, name: str, verb: str) -> None:
        if type(self) is late or name in names:
            raise FrozenInstanceError(f"cannot {verb} field {name!r}")

    def __setattr__(self: object, name: str, value: object) -> None:  # noqa: N807
        held(self, name, "assign to")
        super(late, self).__setattr__(name, value)

    def __delattr__(self: object, name: str) -> None:  # noqa: N807
        held(self, name, "delete")
        super(late, self).__delattr__(name)

    def __getstate__(self: object) -> list[object]:  # noqa: N807
        return [getattr(self, name) for name in names]

    def __setstate__(self: object, state: list[object]) -> None:  # noqa: N807
        for name, value in zip(names, state, strict=False):
            object.__setattr__(self, name, value)

    return {each.__name__: each for each in (__setattr__, __delattr__, __getstate__, __setstate__)}


def _late(defined: type, options: dict[str, bool]) -> Any:  # noqa: ANN401
    """The class with its slots, what is made of them to come. Two threads may both make it: the parts are the same."""
    body = {name: value for name, value in vars(defined).items() if name not in {"__dict__", "__weakref__"}}
    body |= {"__qualname__": defined.__qualname__, "__doc__": defined.__doc__ or defined.__name__}
    notes = defined.__annotations__

    def used() -> Mapping[str, Any]:
        told = {name: getattr(defined, name) for name in notes if hasattr(defined, name)}
        bare: Any = type(defined.__name__, (), {**told, "__annotations__": notes, "__doc__": "."})
        dataclasses.dataclass(bare, init=False, repr=False, eq=False, kw_only=options.get("kw_only", False))
        known: dict[str, Field[Any]] = {}
        for of in (*reversed(defined.__mro__[1:]), bare):
            known |= getattr(of, "__dataclass_fields__", {})
        bare.__dataclass_fields__ = known
        kept = fields(bare)
        given = [each for each in known.values() if each in kept or type(each.type) is InitVar]
        in_order = tuple(each.name for each in given if each.init and not each.kw_only)
        made = {"__dataclass_fields__": known, "__match_args__": in_order, "__signature__": None}  # that of __init__
        return made | _frozen(late, tuple(each.name for each in kept)) | {"__init__": _initializer(late, given)}

    def shown() -> Mapping[str, Any]:
        return vars(dataclasses.dataclass(**options)(type(defined)(defined.__name__, defined.__bases__, dict(body))))

    def complete(name: str) -> Any:  # noqa: ANN401
        made, names = (shown(), SHOWN) if name in SHOWN else (used(), USED)
        for each in names:
            if each in parts:
                setattr(late, each, made[each])
        return late

    slots, kinds = options.get("slots"), {name: getattr(kind, "__origin__", kind) for name, kind in notes.items()}
    own = [name for name, kind in kinds.items() if kind is not ClassVar and type(kind) is not InitVar]
    above = {name for base in defined.__mro__[1:-1] for name in getattr(base, "__slots__", ())}
    not_made = {"__hash__", "__eq__"} if options.get("eq") is False else set[str]()
    not_made |= body.keys() | (set() if slots else {"__getstate__", "__setstate__"})
    parts: dict[str, object] = {name: _WhenRead(name, complete) for name in (*USED, *SHOWN) if name not in not_made}
    space = {"__replace__": replace} | parts | {name: value for name, value in body.items() if name not in own}
    if slots:
        space["__slots__"] = tuple(name for name in own if name not in above)
    else:
        usual = [(name, body[name]) for name in own if name in body]
        space |= {name: value for name, value in usual if not isinstance(value, Field)}
        space |= {name: told.default for name, told in usual if isinstance(told, Field) and told.default is not MISSING}
    late: Any = type(defined)(defined.__name__, defined.__bases__, space)
    return late


if TYPE_CHECKING:
    from dataclasses import dataclass
else:

    def dataclass(cls: type | None = None, /, **options: bool) -> Callable[[type], type] | type:
        """dataclasses.dataclass, late where the class is frozen."""
        late = options.get("frozen") and options.keys() <= {"frozen", "slots", "kw_only", "eq"}
        return (lambda defined: _late(defined, options)) if late else dataclasses.dataclass(cls, **options)
