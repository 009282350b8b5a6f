"""What pages and drawings share: escaped text, and the colours."""

import html
from functools import cache
from importlib.resources import files


def escaped(text: object) -> str:
    """Text as HTML."""
    return html.escape(str(text))


@cache
def palette() -> str:
    """The colours of every page, light and dark."""
    return files("retuner.templates").joinpath("palette.css").read_text(encoding="utf-8")
