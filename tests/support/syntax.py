"""Sources as Python's syntax tree has them, each parsed once for all tests that read code."""

import ast
from functools import cache


@cache
def nodes(source: str) -> tuple[ast.AST, ...]:
    """Every node of a module, from the outside in."""
    return tuple(ast.walk(ast.parse(source)))
