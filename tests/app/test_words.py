"""The words that people read are the trade's, in short sentences: scripts/document_vocabulary.py says which.

Looked at are the texts in the code that reach a person (all that hold a space, but docstrings and program text that is
exported), the templates, the page in the browser, README and docs.
"""

import ast
import importlib.util
import re
from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path
from types import ModuleType

import pytest
from syntax import nodes

ROOT = Path(__file__).resolve().parents[2]


def vocabulary() -> ModuleType:
    """The script that has the words and writes their page."""
    place = importlib.util.spec_from_file_location("document_vocabulary", ROOT / "scripts" / "document_vocabulary.py")
    script = importlib.util.module_from_spec(place)
    place.loader.exec_module(script)
    return script


TERMS = vocabulary().TERMS
FOLDERS = ("src", "adaptive", "drivers", "schedule")
NO_PROSE = ("numbers.py", "store.py", "gate.py", "html.py")
"""Files whose longer texts are C, IEC 61131-3, DBC, SQL, HTTP or CSS."""
DOCS = (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
STATIC = tuple(
    path
    for folder in ("src/retuner/serve/static", "src/retuner/templates")
    for path in sorted((ROOT / folder).iterdir())
    if path.suffix in {".js", ".html", ".toml"} and "min" not in path.name
)
MOST_WORDS_PRINTED = 24
MOST_WORDS_IN_DOCS = 29
FENCED = re.DOTALL | re.MULTILINE
OLD = re.compile(rf"\b(?:{'|'.join(old for term in TERMS for old in term.old)})(?!\w)", re.IGNORECASE)
FORMS = (ast.Dict, ast.List, ast.Set, ast.Tuple, ast.ListComp, ast.DictComp, ast.SetComp, ast.GeneratorExp)
CALLS = {"list", "dict", "set", "tuple", "sorted", "asdict", "gains_dict", "tolist", "to_dict", "_asdict"}
"""What is shown as Python writes it when it stands in an f-string."""


def docstrings(every: tuple[ast.AST, ...]) -> set[int]:
    """The nodes that are documentation: expressions that stand alone, but for the help of a command."""
    helps = {
        id(node.body[0])
        for node in every
        if isinstance(node, ast.FunctionDef) and any("command" in ast.unparse(one) for one in node.decorator_list)
    }
    return {id(node.value) for node in every if isinstance(node, ast.Expr) and id(node) not in helps}


def texts(source: str) -> Iterator[tuple[int, str]]:
    """Line and text of everything that may be shown, an X for each value in it; keys are left out: they have no space,
    or are the names that `plain_values` takes.
    """
    every = nodes(source)
    apart = docstrings(every)
    for node in every:
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "plain_values":
            apart |= {id(one) for one in node.args}
        if isinstance(node, ast.JoinedStr):
            apart |= {id(inner) for inner in node.values if isinstance(inner, ast.Constant)}
            apart |= {id(inner.format_spec) for inner in node.values if isinstance(inner, ast.FormattedValue)}
    beside = {id(one) for node in every for one in _listed(node)}
    for node in every:
        if id(node) in apart:
            continue
        text = ""
        if isinstance(node, ast.JoinedStr):
            parts = (str(part.value) if isinstance(part, ast.Constant) else "X" for part in node.values)
            text = "".join(parts)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            text = re.sub(r"\{[^{} ]*\}", "X", node.value)
        if " " in text.strip() or (text and id(node) in beside):
            yield node.lineno, text


def _listed(node: ast.AST) -> list[ast.expr]:
    """Texts that stand in a row with others of several words or none, as headings do."""
    if not isinstance(node, ast.Tuple | ast.List) or len(node.elts) < 3:
        return []
    values = [one.value for one in node.elts if isinstance(one, ast.Constant) and isinstance(one.value, str)]
    return node.elts if len(values) == len(node.elts) and any(" " in one or not one for one in values) else []


@cache
def printed() -> tuple[tuple[str, str], ...]:
    """Place and text of all that the code may show."""
    return tuple(
        (f"{path.relative_to(ROOT)}:{line}", text)
        for folder in FOLDERS
        for path in sorted((ROOT / folder).rglob("*.py"))
        if path.name not in NO_PROSE
        for line, text in texts(path.read_text(encoding="utf-8"))
    )


def shown_of_page(path: Path) -> list[tuple[int, str]]:
    """Line and text of what a page, template or script shows; of code only the texts in quotes that hold a space."""
    text = path.read_text(encoding="utf-8")
    if path.suffix in {".js", ".html"}:
        blank = partial(re.sub, r"[^\n]", " ")
        text = re.sub(r"<style.*?</style>", lambda found: blank(found.group(0)), text, flags=re.DOTALL)
        text = re.sub(r"\$\{[^}]*\}", "X", text)
        quoted = re.compile(r'"[^"\n]* [^"\n]*"|`[^`\n]* [^`\n]*`|>[^<>\n]*<')
        return [(n, found) for n, line in enumerate(text.splitlines(), 1) for found in quoted.findall(line)]
    if path.suffix == ".md":
        text = re.sub(r"^```mermaid.*?^```", lambda found: re.sub(r"[^\n]", "", found.group(0)), text, flags=FENCED)
        text = re.sub(r"\]\([^)]*\)", "]", text)
    return [(n, re.sub(r"`[^`]*`", "", line)) for n, line in enumerate(text.splitlines(), 1)]


def old_words(text: str) -> list[str]:
    """The words in a text that the vocabulary replaces."""
    return [found.group(0) for found in OLD.finditer(text)]


def sentences(text: str) -> list[str]:
    """A text in sentences: they end with a stop, a semicolon or a blank line."""
    return [one for one in re.split(r"[.!?][*)\"']*\s+|;\s+|\n\s*\n", text) if one.strip()]


def length(sentence: str) -> int:
    """Its words: what has a letter or a number in it."""
    return sum(bool(re.search(r"\w", word)) for word in sentence.split())


def paragraphs(page: str) -> Iterator[str]:
    """The prose of a page in Markdown: paragraphs, items and cells of tables, without headings, code and addresses."""
    page = re.sub(r"^```.*?^```", "\n", page, flags=FENCED)
    page = re.sub(r"\]\([^)]*\)", "]", page)
    block: list[str] = []
    for line in [*page.splitlines(), ""]:
        apart = not line.strip() or line.startswith(("#", "|", "    "))
        if (apart or re.match(r"\s*([-*]|\d+\.)\s", line)) and block:
            yield " ".join(block)
            block = []
        if line.startswith("|"):
            yield from (cell.strip() for cell in line.split("|") if cell.strip())
        elif not apart:
            block.append(line.strip())


def python_forms(source: str) -> list[str]:
    """Values in f-strings that would be shown as lists, dicts, or names of enum members."""
    found = []
    for node in nodes(source):
        if isinstance(node, ast.FormattedValue):
            value = node.value
            name = value.func if isinstance(value, ast.Call) else None
            called = name.id if isinstance(name, ast.Name) else name.attr if isinstance(name, ast.Attribute) else ""
            if isinstance(value, FORMS) or called in CALLS:
                found.append(ast.unparse(value))
    return found


def test_no_old_word_is_shown() -> None:
    assert len(printed()) > 2000
    assert {place: words for place, text in printed() if (words := old_words(text))} == {}


@pytest.mark.parametrize("path", [*DOCS, *STATIC], ids=lambda path: path.name)
def test_no_old_word_stands_in_docs_templates_or_the_page(path: Path) -> None:
    assert [(number, words) for number, text in shown_of_page(path) if (words := old_words(text))] == []


def test_what_is_shown_is_short() -> None:
    long = {p: n for p, text in printed() if (n := max(map(length, sentences(text)), default=0)) > MOST_WORDS_PRINTED}
    assert long == {}


@pytest.mark.parametrize("path", DOCS, ids=lambda path: path.name)
def test_sentences_of_the_docs_are_short(path: Path) -> None:
    told = [one for text in paragraphs(path.read_text(encoding="utf-8")) for one in sentences(text)]
    assert told
    assert [one for one in told if length(one) > MOST_WORDS_IN_DOCS] == []


def test_nothing_is_shown_as_python_writes_it() -> None:
    found = {
        str(path.relative_to(ROOT)): forms
        for folder in FOLDERS
        for path in sorted((ROOT / folder).rglob("*.py"))
        if (forms := python_forms(path.read_text(encoding="utf-8")))
    }
    assert found == {}


def test_the_vocabulary_is_whole() -> None:
    names = [term.term for term in TERMS]
    assert len(set(names)) == len(names) > 20
    assert all(term.meaning.endswith(".") for term in TERMS)
    assert {term.term: words for term in TERMS if (words := old_words(f"{term.term}. {term.meaning}"))} == {}


def test_the_page_of_the_vocabulary_is_what_the_program_says() -> None:
    script = vocabulary()
    assert script.PAGE.read_text(encoding="utf-8") == script.page()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("the gains in force", ["in force"]),
        ("It was Taken back, as promised", ["Taken back", "promised"]),
        ("damping 0.4, a damping ratio of 0.7", ["damping"]),
        ("enforced, undoubted", []),
    ],
)
def test_old_words_are_seen(text: str, words: list[str]) -> None:
    assert old_words(text) == words


SOURCE = '''"""The head."""
def f(n):
    """A doc string."""
    return f"{n:.2f} of " f"{n} parts", "a key"[0], "key", {"k": 1}
'''


def test_texts_are_seen_whole_and_keys_are_not() -> None:
    assert list(texts(SOURCE)) == [(4, "X of X parts"), (4, "a key")]
    assert list(texts('f(("", "in force", "ms"), ("k", "v", "w"))')) == [(1, "in force"), (1, "ms")]


def test_sentences_are_counted() -> None:
    assert [length(one) for one in sentences("One two. Three - four five; six 7 e.g.\n\n8 at 0.5")] == [2, 3, 3, 3]
    assert list(paragraphs("# Head\n\none\ntwo\n\n- item\n- [other](x y z)\n\n    code\n\n| a | b c |\n")) == [
        "one two",
        "- item",
        "- [other]",
        "a",
        "b c",
    ]


def test_what_python_writes_is_seen() -> None:
    source = 'f"{sorted(a)} {[b]} {c.to_dict()} {d} {len(e)}"'
    assert python_forms(source) == ["sorted(a)", "[b]", "c.to_dict()"]
