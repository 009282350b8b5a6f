"""On which line of a TOML text each key stands.

tomllib gives values without places. This scanner gives places without values: it walks a text that tomllib has
already accepted, so it needs to tell apart only what moves it along (keys, headers, strings, brackets), not to judge.
Paths are those of tomllib's document: ("schedule", "region", 1, "kc").
"""

import re
import tomllib
from bisect import bisect_right

Path = tuple[str | int, ...]

BLANK = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
BASIC = r'"(?:[^"\\\n]|\\.)*"'
LITERAL = r"'[^'\n]*'"
KEY_PART = re.compile(rf"[ \t]*([A-Za-z0-9_-]+|{BASIC}|{LITERAL})[ \t]*")
STRING = re.compile(
    rf'"""(?:[^"\\]|\\.|"(?!""))*"""(?:"(?!"")){{0,2}}|\'\'\'.*?\'\'\'\'{{0,2}}|{BASIC}|{LITERAL}', re.DOTALL
)
BARE_VALUE = re.compile(r"[^,\]}#\n]*")


def toml_lines(text: str) -> dict[Path, int]:
    """Line (from 1) of every key, table header and array element of a text that tomllib accepts.

    A table made by several headers stands at its first. The document itself, the empty path, stands on line 1.
    """
    return _Scanner(text).document()


class _Scanner:
    """One pass over the text; `at` is the position of the next character to read."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0
        self.line_ends = [i for i, c in enumerate(text) if c == "\n"]
        self.lines: dict[Path, int] = {(): 1}
        self.table_arrays: dict[Path, int] = {}

    def document(self) -> dict[Path, int]:
        table: Path = ()
        self.blank()
        while self.at < len(self.text):
            if self.text[self.at] == "[":
                table = self.header()
            else:
                self.key_value(table)
            self.blank()
        return self.lines

    def blank(self) -> None:
        match = BLANK.match(self.text, self.at)
        self.at = match.end() if match else self.at

    def line(self) -> int:
        return bisect_right(self.line_ends, self.at - 1) + 1

    def mark(self, path: Path) -> None:
        self.lines.setdefault(path, self.line())

    def header(self) -> Path:
        is_array = self.text.startswith("[[", self.at)
        self.at += 2 if is_array else 1
        self.blank()
        path: Path = ()
        keys = self.key()
        for i, key in enumerate(keys):
            path = (*path, key)
            self.mark(path)
            if is_array and i == len(keys) - 1:
                self.table_arrays[path] = self.table_arrays.get(path, -1) + 1
            if path in self.table_arrays:
                path = (*path, self.table_arrays[path])
                self.mark(path)
        self.at += 2 if is_array else 1
        return path

    def key(self) -> list[str]:
        parts: list[str] = []
        while match := KEY_PART.match(self.text, self.at):
            part = match.group(1)
            parts.append(next(iter(tomllib.loads(f"{part} = 0"))))
            self.at = match.end()
            if self.text[self.at : self.at + 1] != ".":
                break
            self.at += 1
        return parts

    def key_value(self, table: Path) -> None:
        start = self.at
        path = table
        for part in self.key():
            path = (*path, part)
            here, self.at = self.at, start
            self.mark(path)
            self.at = here
        self.at += 1  # the equals sign
        self.value(path)

    def value(self, path: Path) -> None:
        self.blank()
        opening = self.text[self.at]
        if opening == "[":
            self.array(path)
        elif opening == "{":
            self.at += 1
            self.blank()
            while self.text[self.at] != "}":
                self.key_value(path)
                self.skip_comma()
            self.at += 1
        else:
            match = STRING.match(self.text, self.at) or BARE_VALUE.match(self.text, self.at)
            self.at = match.end() if match else self.at + 1

    def array(self, path: Path) -> None:
        self.at += 1
        index = 0
        self.blank()
        while self.text[self.at] != "]":
            self.mark((*path, index))
            self.value((*path, index))
            index += 1
            self.skip_comma()
        self.at += 1

    def skip_comma(self) -> None:
        self.blank()
        if self.text[self.at] == ",":
            self.at += 1
        self.blank()
