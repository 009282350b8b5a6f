"""How a result shows itself to a person: as text, and as a page with its picture in a notebook.

The results of `adaptive` are values. Their words and pictures stand in `src/retuner`, which names its module here.
"""

from collections.abc import Callable
from typing import Any, Protocol, cast


class Shows(Protocol):
    """What the module of words and pictures has."""

    def text(self, result: object) -> str:
        """The result in words."""

    def html(self, result: object) -> str:
        """The result with its picture, as a part of an HTML page."""

    def figure(self, result: object) -> Any:  # noqa: ANN401  matplotlib's Figure, which this package does not import
        """The picture of the result."""


_module: list[Callable[[], Shows]] = []


def shown_by(name: str, load: Callable[[str], object]) -> None:
    """Say which module shows results; it is loaded when the first one is shown."""
    _module[:] = [lambda: cast("Shows", load(name))]


class Drawn:
    """A result of which a notebook shows a picture."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        return _module[0]().html(self)


class Shown(Drawn):
    """A result of which print gives the lines of its command besides."""

    __slots__ = ()

    def __str__(self) -> str:
        return _module[0]().text(self)


def figure(result: object) -> Any:  # noqa: ANN401  matplotlib's Figure, which this package does not import
    """The picture of a result. Raises ValueError: there is nothing to draw: the record was not kept."""
    return _module[0]().figure(result)
