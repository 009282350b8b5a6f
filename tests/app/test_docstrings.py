"""What docstrings of public names show runs as printed; what is called says what it gives and what it refuses."""

import doctest
import inspect
from collections.abc import Iterator
from importlib import import_module

import pytest

import retuner

FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
TOLD = ("PidController", "PidGains", "diagnose", "identify", "read", "tune")
"""Names that people call first: they have an example."""


def homes() -> list[str]:
    return sorted({getattr(retuner, name).__module__ for name in retuner.__all__})


def examples() -> Iterator[doctest.DocTest]:
    finder = doctest.DocTestFinder()
    for home in homes():
        yield from (found for found in finder.find(import_module(home)) if found.examples)


@pytest.mark.parametrize("example", list(examples()), ids=lambda example: example.name)
def test_examples_give_what_they_show(example: doctest.DocTest) -> None:
    said: list[str] = []
    doctest.DocTestRunner(optionflags=FLAGS).run(example, out=said.append)
    assert not said, "".join(said)


@pytest.mark.parametrize("name", TOLD)
def test_what_people_call_first_has_an_example(name: str) -> None:
    assert ">>> " in (inspect.getdoc(getattr(retuner, name)) or "")


@pytest.mark.parametrize("name", [name for name in retuner.__all__ if inspect.isfunction(getattr(retuner, name))])
def test_a_function_says_what_it_gives_and_refuses(name: str) -> None:
    said = inspect.getdoc(getattr(retuner, name)) or ""
    for heading in (
        "Parameters",
        "Returns",
        *(["Raises"] if name not in {"margins", "remember"} else []),
    ):  # any loop has margins, or none; any retuner can be remembered
        assert f"\n{heading}\n{'-' * len(heading)}\n" in said, heading
