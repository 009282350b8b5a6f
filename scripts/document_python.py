"""Write the page of the Python interface: every name of `import retuner`; the docstrings are filled in by `make docs`.

python scripts/document_python.py
"""

import sys
from enum import EnumMeta

import retuner

HEAD = """# Python interface

Everything that `import retuner` gives, from its own docstrings. How it is used: [the Python user](how-to-python.md).
Times are in seconds, gains are of the parallel form unless a name says otherwise; all results are frozen.
"""
DIRECTIVES = {"Functions": "autofunction", "Classes": "autoclass", "Choices": "autoclass", "Values": "autodata"}
OPTIONS = {"autoclass": "   :members:\n"}


def page() -> str:
    """The page as Markdown, with a directive for each name."""
    groups: dict[str, list[str]] = {kind: [] for kind in DIRECTIVES}
    for name in retuner.__all__:
        groups[kind_of(getattr(retuner, name))].append(name)
    return HEAD + "".join(section(kind, names) for kind, names in groups.items() if names)


def kind_of(value: object) -> str:
    """Under which heading a name belongs."""
    if isinstance(value, EnumMeta):
        return "Choices"
    if isinstance(value, type):
        return "Classes"
    return "Functions" if callable(value) else "Values"


def section(kind: str, names: list[str]) -> str:
    """One heading with its names."""
    directive = DIRECTIVES[kind]
    of = "".join(f".. {directive}:: retuner.{name}\n{OPTIONS.get(directive, '')}\n" for name in names)
    return f"\n## {kind}\n\n```{{eval-rst}}\n{of}```\n"


if __name__ == "__main__":
    sys.stdout.write(page())
