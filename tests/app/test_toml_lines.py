"""The scanner finds a line for exactly the paths that tomllib finds values for, and the right one."""

import tomllib
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.config.toml_lines import Path, toml_lines

TRICKY = '''# head
schema = 1
"quoted key" . sub = 1
a.b.c = { x = 1, "y z" = [1, { w = 2 }], s = "} # ] \\" , " }

[loop] # comment with ] and [x]
name = "a [b] # c"
multi = """first
"quoted" second \\"""
third"""
lit = \'\'\'
it''s raw \\
\'\'\'
list = [
  1, # one
  [2,
   3],
  "x",
]
date = 1979-05-27 07:32:00

[[schedule.region]]
kc = 1
[schedule.region.sub]
deep = 1
[[schedule.region]]
kc = 2
[[schedule.region.inner]]
q = 1
[[schedule.region.inner]]
q = 2
ends = """two quotes at the end"""""
last = 1
'''


def paths(value: object, at: Path = ()) -> Iterator[Path]:
    yield at
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from paths(inner, (*at, key))
    if isinstance(value, list):
        for index, inner in enumerate(value):
            yield from paths(inner, (*at, index))


def line_of(text: str, start: str) -> int:
    return next(i for i, line in enumerate(text.splitlines(), 1) if line.lstrip().startswith(start))


def test_same_paths_as_tomllib() -> None:
    assert set(toml_lines(TRICKY)) == set(paths(tomllib.loads(TRICKY)))


@pytest.mark.parametrize(
    ("path", "start"),
    [
        (("schema",), "schema"),
        (("quoted key", "sub"), '"quoted key"'),
        (("a", "b", "c", "y z", 1, "w"), "a.b.c"),
        (("loop",), "[loop]"),
        (("loop", "lit"), "lit"),
        (("loop", "list", 1), "[2,"),
        (("loop", "list", 1, 1), "3]"),
        (("schedule",), "[[schedule"),
        (("schedule", "region", 0, "sub", "deep"), "deep"),
        (("schedule", "region", 1, "kc"), "kc = 2"),
        (("schedule", "region", 1, "inner", 1, "q"), "q = 2"),
        (("schedule", "region", 1, "inner", 1, "last"), "last"),
    ],
)
def test_lines(path: Path, start: str) -> None:
    assert toml_lines(TRICKY)[path] == line_of(TRICKY, start)


def test_windows_line_ends_count_the_same() -> None:
    assert toml_lines(TRICKY.replace("\n", "\r\n")) == toml_lines(TRICKY)


KEYS = st.text(alphabet="ab.\"'#[]{}=, \\é", min_size=1, max_size=4)
SCALARS = st.one_of(
    st.integers(-9, 9).map(str),
    st.sampled_from(["true", "inf", "1e3", "07:32:00", '"""a\n#"b"""', "'''\n]'''", '"\\\\"', "'\\'", '""', '"}"']),
)


def quoted(key: str) -> str:
    return '"' + key.replace("\\", "\\\\").replace('"', '\\"') + '"'


def inline(pairs: dict[str, str]) -> str:
    return "{" + ", ".join(f"{quoted(k)} = {v}" for k, v in pairs.items()) + "}"


VALUES = st.recursive(
    SCALARS,
    lambda inner: st.one_of(
        st.lists(inner, max_size=3).map(lambda items: "[\n" + " , # ]\n".join(items) + "\n]"),
        st.dictionaries(KEYS, inner, max_size=2).map(inline),
    ),
    max_leaves=6,
)


@given(st.dictionaries(KEYS, VALUES, max_size=4), st.lists(st.dictionaries(KEYS, VALUES, max_size=2), max_size=3))
def test_any_document_gives_the_paths_of_tomllib(top: dict[str, str], tables: list[dict[str, str]]) -> None:
    text = "".join(f"{quoted(k)} = {v} # c\n" for k, v in top.items())
    for table in tables:
        text += "[[ 'array of' . tables ]]\n" + "".join(f"{quoted(k)} = {v}\n" for k, v in table.items())
    assert set(toml_lines(text)) == set(paths(tomllib.loads(text)))
