"""The mutations: signs, comparisons, minima and truth values, flipped one at a time.

Cosmic Ray walks the syntax tree, counts the places and writes the mutant out; its own operators
swap + and -, exchange comparisons and delete unary ones. Those below add what it lacks.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple, Protocol

from clfcbf.errors import MissingExtraError

__all__ = ["Minus", "Operator", "Replacement", "operators"]

_Position = tuple[tuple[int, int], tuple[int, int]]

_BUILT_IN = (
    "binary_operator_replacement.ReplaceBinaryOperator_Add_Sub",
    "binary_operator_replacement.ReplaceBinaryOperator_Sub_Add",
    "unary_operator_replacement.ReplaceUnaryOperator_Delete_USub",
    "unary_operator_replacement.ReplaceUnaryOperator_Delete_Not",
    *(
        f"comparison_operator_replacement.ReplaceComparisonOperator_{pair}"
        for pair in (
            "Lt_LtE", "Lt_Gt", "LtE_Lt", "LtE_GtE", "Gt_GtE", "Gt_Lt", "GtE_Gt", "GtE_LtE",
            "Eq_NotEq", "NotEq_Eq",
        )
    ),
)  # fmt: skip

_ARITHMETIC = frozenset({"term", "atom_expr", "name", "number", "power"})
_PLACES = frozenset(
    {
        "arglist", "argument", "comparison", "expr_stmt", "return_stmt", "ternary",
        "testlist_comp", "testlist_star_expr", "yield_expr",
    }
)  # fmt: skip
_TUPLES = frozenset({"testlist_star_expr", "testlist_comp", "exprlist", "atom"})
_SILENT = frozenset({"raise_stmt", "decorator", "import_from", "import_name", "tfpdef", "fstring"})
_EVEN = frozenset({"abs", "cos", "fabs", "hypot", "isfinite"})


class Operator(Protocol):
    """What Cosmic Ray asks of an operator; its nodes are parso's."""

    def mutation_positions(self, node: Any) -> Iterator[_Position]:
        """Where ``node`` itself can be mutated, one entry a mutation."""

    def mutate(self, node: Any, index: int) -> Any:
        """The node with mutation number ``index`` made to it."""


class Replacement(NamedTuple):
    """A named operator."""

    name: str
    operator: Operator


def operators() -> tuple[Replacement, ...]:
    """Every operator, Cosmic Ray's and ours.

    Raises
    ------
    MissingExtraError : Cosmic Ray is not installed
    """
    try:
        from cosmic_ray import operators as library
        from cosmic_ray.operators import (  # noqa: F401 (found by name below)
            binary_operator_replacement,
            comparison_operator_replacement,
            unary_operator_replacement,
        )
    except ImportError as error:
        raise MissingExtraError("cosmic-ray", "dev") from error
    found = []
    for path in _BUILT_IN:
        module, name = path.split(".")
        found.append(Replacement(name, getattr(getattr(library, module), name)()))
    ours: tuple[Operator, ...] = (
        Minus(), _AugmentedSign(), _Extremum(), _NoAbsoluteValue(), _NegatedTruth(),
    )  # fmt: skip
    return (*found, *(Replacement(type(each).__name__.lstrip("_"), each) for each in ours))


def _span(node: Any) -> _Position:
    return node.start_pos, node.end_pos


def _silent(node: Any) -> bool:
    """Whether ``node`` belongs to what is not computed with: messages, types, imports."""
    while node.parent is not None:
        parent = node.parent
        if parent.type in _SILENT or (parent.type == "annassign" and node is parent.children[1]):
            return True
        if parent.type == "funcdef" and node is parent.annotation:
            return True
        node = parent
    return False


class Minus:
    """A minus before a whole product, name, call or number.

    Not before a later factor of a product, which is the same mutant as one before the product; not
    before what already has one, which deleting it covers; and not where a sign says nothing: in a
    subscript, a truth value, a comparison with zero, the argument of an even function.
    """

    def mutation_positions(self, node: Any) -> Iterator[_Position]:
        if node.type not in _ARITHMETIC or node.parent is None or _silent(node):
            return
        if _is_not_a_value(node) or (node.type == "number" and _is_zero(node)):
            return
        parent = node.parent
        if parent.type == "arith_expr":
            placed = node is parent.children[0]
        elif parent.type in {"atom", "trailer"}:
            placed = parent.children[0].value == "(" and not _is_even(parent)
        elif parent.type == "annassign":
            placed = node is parent.children[-1]
        elif parent.type == "param":  # a default
            placed = node.type == "number"
        elif parent.type == "comparison":
            equal = parent.children[1].type == "operator" and parent.children[1].value in "==!="
            placed = not (equal and any(map(_is_zero, parent.children)))
        else:
            placed = parent.type in _PLACES
            if parent.type == "arglist":
                placed = not _is_even(parent.parent)
        if placed:
            yield _span(node)

    def mutate(self, node: Any, index: int) -> Any:
        first = node.get_first_leaf()
        first.value = "-" + first.value
        return node


def _is_even(call: Any) -> bool:
    """Whether these parentheses are the call of a function to which a sign means nothing."""
    before = call.get_previous_sibling()
    return before is not None and before.get_last_leaf().value in _EVEN


def _is_zero(node: Any) -> bool:
    if node.type != "number":
        return False
    text = node.value
    return float(int(text, 0) if text.isdigit() else text) == 0.0


def _is_not_a_value(node: Any) -> bool:
    """Whether a node is the target of an assignment, a keyword, a loop variable or an attribute."""
    parent = node.parent
    if parent.type == "argument":
        return bool(node is parent.children[0] and len(parent.children) > 1)
    while parent.type in _TUPLES and parent.parent is not None:
        node, parent = parent, parent.parent
    if parent.type == "expr_stmt":
        return node is not parent.children[-1]
    return parent.type in {"for_stmt", "sync_comp_for"} and node is parent.children[1]


class _AugmentedSign:
    """``+=`` for ``-=`` and the other way round."""

    _OTHER = {"+=": "-=", "-=": "+="}  # noqa: RUF012 (never written to)

    def mutation_positions(self, node: Any) -> Iterator[_Position]:
        if node.type == "operator" and node.value in self._OTHER:
            yield _span(node)

    def mutate(self, node: Any, index: int) -> Any:
        node.value = self._OTHER[node.value]
        return node


class _Extremum:
    """``min`` for ``max`` and the other way round."""

    _OTHER = {"min": "max", "max": "min"}  # noqa: RUF012 (never written to)

    def mutation_positions(self, node: Any) -> Iterator[_Position]:
        if _is_called(node, self._OTHER):
            yield _span(node)

    def mutate(self, node: Any, index: int) -> Any:
        node.value = self._OTHER[node.value]
        return node


class _NoAbsoluteValue:
    """``(x)`` for ``abs(x)``."""

    def mutation_positions(self, node: Any) -> Iterator[_Position]:
        if _is_called(node, {"abs"}):
            yield _span(node)

    def mutate(self, node: Any, index: int) -> Any:
        node.value = ""
        return node


def _is_called(node: Any, names: Any) -> bool:
    if node.type != "name" or node.value not in names or node.parent.type != "atom_expr":
        return False
    return bool(node is node.parent.children[0])


class _NegatedTruth:
    """``return not (...)`` in a function that is declared to return a bool."""

    def mutation_positions(self, node: Any) -> Iterator[_Position]:
        if node.type != "return_stmt":
            return
        parent = node.parent
        while parent is not None and parent.type != "funcdef":
            parent = parent.parent
        declared = getattr(parent, "annotation", None)
        if declared is not None and declared.get_code().strip() == "bool":
            yield _span(node)

    def mutate(self, node: Any, index: int) -> Any:
        value = node.children[1]
        value.get_first_leaf().value = "not (" + value.get_first_leaf().value
        value.get_last_leaf().value += ")"
        return node
