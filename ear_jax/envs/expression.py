"""Rewards as expressions over a family's outcomes, such as `1 if 2 < velocity < 3 else -0.1*squared_action`.

An expression is parsed into Python's syntax tree and built from a short list of its nodes; nothing is evaluated as
Python. It has no attributes, no names besides the outcomes', and no calls besides those of `FUNCTIONS`.
"""

from __future__ import annotations

import ast
import math
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import reduce
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp

from ear_jax.errors import UsageError, counted, plain, unknown

Outcome = dict[str, jax.Array]
Value = Callable[[Outcome], Any]  # of a part of an expression

LONGEST, DEEPEST = 1000, 100  # letters of an expression, and levels of its syntax tree
FUNCTIONS: dict[
    str, tuple[Callable[..., jax.Array], int, int | None]
] = {  # fewest and most arguments; None: any number
    "abs": (jnp.abs, 1, 1),
    "clip": (jnp.clip, 3, 3),
    "cos": (jnp.cos, 1, 1),
    "exp": (jnp.exp, 1, 1),
    "log": (jnp.log, 1, 1),
    "max": (lambda *values: reduce(jnp.maximum, values), 2, None),
    "min": (lambda *values: reduce(jnp.minimum, values), 2, None),
    "sign": (jnp.sign, 1, 1),
    "sin": (jnp.sin, 1, 1),
    "sqrt": (jnp.sqrt, 1, 1),
    "tanh": (jnp.tanh, 1, 1),
}
OPERATORS: dict[type[ast.AST], Callable[..., jax.Array]] = {
    ast.Add: jnp.add,
    ast.Sub: jnp.subtract,
    ast.Mult: jnp.multiply,
    ast.Div: jnp.divide,
    ast.Pow: jnp.power,
    ast.USub: jnp.negative,
    ast.UAdd: jnp.positive,
    ast.And: jnp.logical_and,
    ast.Or: jnp.logical_or,
    ast.Lt: jnp.less,
    ast.LtE: jnp.less_equal,
    ast.Gt: jnp.greater,
    ast.GtE: jnp.greater_equal,
    ast.Eq: jnp.equal,
    ast.NotEq: jnp.not_equal,
}
UNKNOWN: dict[type[ast.AST], str] = {
    ast.Mod: "%",
    ast.FloorDiv: "//",
    ast.MatMult: "@",
    ast.BitXor: "^ (a power is **)",
}
ALLOWED = "+ - * / **, < <= > >= == !=, and, or, not, X if … else Y, numbers, outcomes and functions"


@dataclass(frozen=True)
class Expression:
    """A reward written as text, a function of one outcome."""

    text: str
    value: Value

    def __call__(self, outcome: Outcome) -> jax.Array:
        """Returns the reward of an outcome, a float scalar; a truth value counts as 1 or 0."""
        return jnp.asarray(self.value(outcome), jnp.float32)


def parse_expression(text: str, outcomes: Iterable[str]) -> Expression:
    """Parses a reward.

    Args:
      text: the expression, as in `-abs(velocity - 3) if squared_action < 2 else -10`.
      outcomes: the names that it may use.

    Raises:
      UsageError: it is no such expression; one line with the column of the mistake, and the nearest name.
    """
    names = sorted(outcomes)
    line = "".join(" " if letter.isspace() else letter for letter in text)  # one column for each letter
    begin = len(line) - len(line.lstrip())
    if not line.strip():
        raise UsageError(f"a reward is empty; write one of the outcomes: {', '.join(names)}")
    if len(line) > LONGEST:
        raise UsageError(f"a reward has {len(line)} letters; {LONGEST} are allowed")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Python's advice on code, such as `1is 1`
            tree = ast.parse(line.strip(), mode="eval")
        if _depth(tree) > DEEPEST:
            raise RecursionError
        return Expression(line.strip(), _Builder(line, begin, names).build(tree.body))
    except SyntaxError as error:
        column = begin + (error.offset if error.lineno == 1 and error.offset else len(line.strip()) + 1)
        raise UsageError(f"column {column} of reward {plain(text)!r}: {error.msg}") from None
    except (RecursionError, MemoryError):
        raise UsageError(f"reward {plain(text[:40])!r}… is nested too deeply") from None
    except ValueError as error:  # a zero byte, or a number with thousands of digits
        raise UsageError(f"reward {plain(text[:40])!r} cannot be read: {error}") from None


@dataclass(frozen=True)
class _Builder:
    """Builds the functions of an expression's nodes, from the leaves up."""

    line: str
    begin: int  # letters before the expression
    names: list[str]

    def build(self, node: ast.AST) -> Value:
        """Returns the function of a node; raises UsageError for a node that no reward has."""
        match node:
            case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
                return self._number(node, number)
            case ast.Name(id=name):
                if name not in self.names:
                    raise self._mistake(node, str(unknown("outcome", name, self.names)))
                return lambda outcome: outcome[name]
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return _applied(jnp.logical_not, self.build(operand))
            case ast.UnaryOp(op=operator, operand=operand) if type(operator) in OPERATORS:
                return _of_numbers(OPERATORS[type(operator)], self.build(operand))
            case ast.BinOp(left=left, op=operator, right=right) if type(operator) in OPERATORS:
                return _of_numbers(OPERATORS[type(operator)], self.build(left), self.build(right))
            case ast.BoolOp(op=operator, values=values):
                return _joined(OPERATORS[type(operator)], [self.build(value) for value in values])
            case ast.Compare(left=left, ops=operators, comparators=others):
                return self._comparison(node, [left, *others], operators)
            case ast.IfExp(test=test, body=body, orelse=orelse):
                return _applied(jnp.where, self._truth(test), self.build(body), self.build(orelse))
            case ast.Call():
                return self._call(node)
        raise self._mistake(node, f"{_shown(node)} is not allowed in a reward (there are: {ALLOWED})")

    def _number(self, node: ast.AST, number: float) -> Value:
        try:
            finite = math.isfinite(number)
        except OverflowError:
            finite = False
        if not finite or abs(number) > jnp.finfo(jnp.float32).max:
            raise self._mistake(node, "a number is too large")
        constant = jnp.float32(number)
        return lambda _: constant

    def _truth(self, node: ast.AST) -> Value:
        return _applied(lambda value: jnp.asarray(value) != 0, self.build(node))

    def _comparison(self, node: ast.AST, sides: list[ast.expr], operators: list[ast.cmpop]) -> Value:
        if any(type(operator) not in OPERATORS for operator in operators):
            raise self._mistake(node, f"in and is are not allowed in a reward (there are: {ALLOWED})")
        values, compare = [self.build(side) for side in sides], [OPERATORS[type(operator)] for operator in operators]

        def compared(outcome: Outcome) -> Any:
            found = [value(outcome) for value in values]  # each side once
            pairs = zip(compare, pairwise(found), strict=True)
            return reduce(jnp.logical_and, [holds(*pair) for holds, pair in pairs])

        return compared

    def _call(self, node: ast.Call) -> Value:
        if not isinstance(node.func, ast.Name):
            raise self._mistake(node, f"only these can be called: {', '.join(FUNCTIONS)}")
        name = node.func.id
        if name not in FUNCTIONS:
            raise self._mistake(node, str(unknown("function", name, FUNCTIONS)))
        function, fewest, most = FUNCTIONS[name]
        count = len(node.args)
        if node.keywords or any(isinstance(argument, ast.Starred) for argument in node.args):
            raise self._mistake(node, f"{name} takes values only, as in {name}({', '.join('xyz'[:fewest])})")
        if count < fewest or (most is not None and count > most):
            wanted = "" if most == fewest else "at least "
            raise self._mistake(node, f"{name} takes {wanted}{counted(fewest, 'value')}, not {count}")
        return _of_numbers(function, *map(self.build, node.args))

    def _mistake(self, node: ast.AST, reason: str) -> UsageError:
        """Returns the error at a node; Python counts its columns in bytes."""
        bytes_before = getattr(node, "col_offset", 0)
        column = self.begin + len(self.line.strip().encode()[:bytes_before].decode()) + 1
        return UsageError(f"column {column} of reward {plain(self.line.strip())!r}: {reason}")


def _depth(tree: ast.AST) -> int:
    """Returns the number of levels of a syntax tree."""
    depth, level = 0, [tree]
    while level:
        depth, level = depth + 1, [child for node in level for child in ast.iter_child_nodes(node)]
    return depth


def _applied(function: Callable[..., Any], *values: Value) -> Value:
    return lambda outcome: function(*(value(outcome) for value in values))


def _of_numbers(function: Callable[..., Any], *values: Value) -> Value:
    """Applies a function of numbers; truth values count as 1 or 0."""
    return _applied(lambda *numbers: function(*(jnp.asarray(number, jnp.float32) for number in numbers)), *values)


def _joined(function: Callable[..., Any], values: list[Value]) -> Value:
    return lambda outcome: reduce(function, [value(outcome) for value in values])


def _shown(node: ast.AST) -> str:
    """Returns the words for a node that no reward has."""
    if isinstance(node, ast.Constant):
        return "a text" if isinstance(node.value, str) else repr(node.value)
    if isinstance(node, ast.BinOp):
        return UNKNOWN.get(type(node.op), "this operator")
    words = {ast.Attribute: "an attribute", ast.Subscript: "an index", ast.Lambda: "a function"}
    return words.get(type(node), f"a Python {type(node).__name__}")
