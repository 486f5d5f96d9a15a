"""Mutants of a module: its text with one place changed, and a name that outlives line numbers."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Collection, Iterator
from itertools import count
from typing import Any, NamedTuple

from benchmarks.mutation.operators import Minus, operators

__all__ = ["PROBE", "Key", "Mutant", "mutants", "probed"]

PROBE = "__mutation_probe__"
"""Name of the function that :func:`probed` text calls with a number and a value, to return it."""


class Key(NamedTuple):
    """What a mutant is known by: neither its line number nor its operator.

    Attributes
    ----------
    module : path of the file, from the root of the tree
    scope : qualified name of the class or function, empty at module level
    line, mutant : the line before and after, without indentation
    copy : counts lines of the same text in one scope
    """

    module: str
    scope: str
    line: str
    mutant: str
    copy: int = 0

    def __str__(self) -> str:
        at = f"{self.module}:{self.scope}" + (f" #{self.copy}" if self.copy else "")
        return f"{at}\n  - {self.line}\n  + {self.mutant}"


class Mutant(NamedTuple):
    """One mutant.

    Attributes
    ----------
    key : its name
    number : of the line that differs
    operator : that made it
    text : the module's whole text
    """

    key: Key
    number: int
    operator: str
    text: str


def mutants(module: str, text: str, signless: Collection[int] = ()) -> Iterator[Mutant]:
    """Every mutant of ``text`` that is another program, each once.

    Parameters
    ----------
    module : path of the file, from the root of the tree
    text : of the module
    signless : places of a minus, as :func:`probed` numbers them, where values have no sign
    """
    from cosmic_ray.mutating import mutate_code

    scopes, messages = _scopes(text), _messages(text)
    lines = text.splitlines()
    seen = {ast.dump(ast.parse(text))}
    copies: Counter[Key] = Counter()
    for name, operator in operators():
        for occurrence in count():
            mutated = mutate_code(text, operator, occurrence)
            if mutated is None:
                break
            tree = ast.dump(ast.parse(mutated))
            if tree in seen or (isinstance(operator, Minus) and occurrence in signless):
                continue
            seen.add(tree)
            after = mutated.splitlines()
            at = next(i for i, (a, b) in enumerate(zip(lines, after, strict=True)) if a != b)
            if at in messages:
                continue
            key = Key(module, scopes[at], lines[at].strip(), after[at].strip())
            yield Mutant(key._replace(copy=copies[key]), at + 1, name, mutated)
            copies[key] += 1


def probed(text: str) -> str:
    """``text`` with every value that could take a minus shown to :data:`PROBE` on the way."""
    from cosmic_ray.ast import ast_nodes, get_ast

    tree = get_ast(text)
    # All places before any change: the text in front of a node would hide what it is.
    operator = Minus()
    places: list[Any] = [
        node for node in ast_nodes(tree) for _ in operator.mutation_positions(node)
    ]
    for number, node in reversed(tuple(enumerate(places))):  # the inner ones first
        first, last = node.get_first_leaf(), node.get_last_leaf()
        first.value = f"{PROBE}({number}, {first.value}"
        last.value += ")"
    return str(tree.get_code())


def _messages(text: str) -> set[int]:
    """Lines of ``raise`` statements, counted from 0: what an error says is not computed with."""
    return {
        line - 1
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Raise)
        for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }


def _scopes(text: str) -> list[str]:
    """Qualified name of the innermost class or function of each line."""
    names = [""] * len(text.splitlines())

    def name(body: list[ast.stmt], prefix: str) -> None:
        for node in body:
            if isinstance(node, ast.ClassDef | ast.FunctionDef):
                qualified = f"{prefix}{node.name}"
                last = node.end_lineno or node.lineno
                names[node.lineno - 1 : last] = [qualified] * (last - node.lineno + 1)
                name(node.body, f"{qualified}.")

    name(ast.parse(text).body, "")
    return names
