"""A class whose methods are made late is the one that `dataclasses` makes at once."""

import copy
import dataclasses
import inspect
import pickle
import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, ClassVar

import pytest

from retuner.schedule import late_dataclass

Decorator = Callable[..., Any]


def classes(dataclass: Decorator) -> SimpleNamespace:
    """One class and one above it, by one decorator or the other."""

    @dataclass(frozen=True, slots=True)
    class Gains:
        """Of a controller."""

        UNIT: ClassVar[str] = "1/s"
        kp: float
        ki: float = 0.5
        names: list[str] = late_dataclass.field(default_factory=list, compare=False)
        sum: float = late_dataclass.field(init=False, repr=False, default=0.0)

        def __post_init__(self) -> None:
            if self.kp < 0:
                raise ValueError("kp is negative")
            object.__setattr__(self, "sum", self.kp + self.ki)

        @property
        def twice(self) -> float:
            return 2 * self.kp

    @dataclass(frozen=True, slots=True, kw_only=True)
    class More(Gains):
        kd: float = 0.0
        ki: float = 0.25

        def __repr__(self) -> str:
            return "more"

    return SimpleNamespace(a=Gains, b=More)


Gains = classes(late_dataclass.dataclass).a
Gains.__qualname__ = "Gains"
BOTH = (classes(dataclasses.dataclass), classes(late_dataclass.dataclass))


def told(of: SimpleNamespace, ask: Callable[[SimpleNamespace], object]) -> object:
    """The answer, or the error in its words."""
    try:
        return ask(of)
    except Exception as error:  # noqa: BLE001  whichever it is, both must raise the same
        return type(error).__name__, str(error)


@pytest.mark.parametrize(
    "ask",
    [
        lambda c: (repr(c.a(1.0)), repr(c.b(kp=1.0)), repr(c.a(1.0, 2.0, ["a"]))),
        lambda c: (
            c.a(1.0) == c.a(1.0),
            c.a(1.0) == c.a(2.0),
            c.a(1.0) == c.b(kp=1.0),
            c.a(1.0, names=["a"]) == c.a(1.0),
        ),
        lambda c: (
            hash(c.a(1.0)),
            hash(c.b(kp=1.0)),
            c.a(1.0).sum,
            c.b(kp=1.0, kd=3.0).kd,
            c.b(kp=2.0).twice,
            c.a.UNIT,
        ),
        lambda c: (c.a(1.0).names is c.a(1.0).names, dataclasses.asdict(c.b(kp=1.0)), dataclasses.astuple(c.a(1.0))),
        lambda c: ([f.name for f in dataclasses.fields(c.b)], dataclasses.is_dataclass(c.a), c.a.__match_args__),
        lambda c: (str(inspect.signature(c.a)), str(inspect.signature(c.b)), c.a.__slots__, c.b.__slots__, c.a.__doc__),
        lambda c: (repr(dataclasses.replace(c.a(1.0), ki=3.0)), c.b.__match_args__, hasattr(c.b(kp=1.0), "__dict__")),
        lambda c: (copy.deepcopy(c.b(kp=1.0)) == c.b(kp=1.0), c.a.__dataclass_params__.frozen),
        lambda c: c.a(),
        lambda c: c.a(-1.0),
        lambda c: c.b(1.0, 2.0, [], 3.0),
        lambda c: c.a(1.0, nothing=2.0),
        lambda c: setattr(c.a(1.0), "kp", 2.0),
        lambda c: delattr(c.b(kp=1.0), "kp"),
        lambda c: dataclasses.replace(c.a(1.0), sum=2.0),
    ],
)
def test_it_says_what_the_usual_one_says(ask: Callable[[SimpleNamespace], object]) -> None:
    usual, late = (told(of, ask) for of in BOTH)
    assert late == usual


def test_a_pickle_is_read_before_any_object_was_made() -> None:
    read = pickle.dumps(Gains(1.0, 2.0, ["a"]))
    other = classes(late_dataclass.dataclass).a
    again = copy.copy(Gains(1.0, 2.0, ["a"]))
    empty = other.__new__(other)
    empty.__setstate__(again.__getstate__())
    assert (repr(empty), hash(empty)) == (f"{other.__qualname__}(kp=1.0, ki=2.0, names=['a'])", hash(Gains(1.0, 2.0)))
    assert pickle.loads(read) == Gains(1.0, 2.0)


def test_nothing_is_made_before_it_is_used() -> None:
    late = classes(late_dataclass.dataclass).a
    assert type(vars(late)["__init__"]).__module__ == late_dataclass.__name__
    late(1.0)
    assert vars(late)["__init__"].__qualname__.endswith("Gains.__init__")


def test_threads_that_make_the_first_objects_at_once_get_them_all() -> None:
    late = classes(late_dataclass.dataclass).a
    start, found = threading.Barrier(8), []

    def make() -> None:
        start.wait()
        found.append(late(1.0))

    threads = [threading.Thread(target=make) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [late(1.0)] * 8


def test_fields_of_a_class_without_slots_are_inherited() -> None:
    @late_dataclass.dataclass(frozen=True, kw_only=True)
    class Bare:
        a: int = 1

    @late_dataclass.dataclass(frozen=True, slots=True, kw_only=True)
    class Slotted(Bare):
        b: int = 2

    assert repr(Slotted(a=3)).endswith("Slotted(a=3, b=2)")
    assert dataclasses.replace(Slotted(), a=5).a == 5
    with pytest.raises(dataclasses.FrozenInstanceError):
        Slotted().a = 4  # type: ignore[misc]
