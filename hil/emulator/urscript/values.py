"""Expressions of URScript: numbers, texts, lists, poses, variables and function calls.

URScript's expressions are a subset of Python's (a pose `p[...]` reads as a subscript), so Python's
own parser reads them; only the few kinds of nodes below are evaluated.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

from cell.errors import BackendError

Value: TypeAlias = "bool | int | float | str | list[Value] | Pose"


class Pose(tuple[float, ...]):
    """A pose: position [m] and axis-angle [rad], 6 numbers."""

    __slots__ = ()


_BINARY: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Mod: math.fmod,
}
_MAX_DEPTH = 12
Function = Callable[..., Value]


def parse(text: str) -> ast.expr:
    """Read one expression.

    Raises:
        BackendError: it is none.
    """
    try:
        return ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise BackendError(f"cannot read {text.strip()[:80]!r}") from None


def called(node: ast.expr) -> list[ast.Call]:
    """All calls inside an expression.

    Raises:
        BackendError: something is called that is not a plain name.
    """
    calls = [n for n in ast.walk(node) if isinstance(n, ast.Call)]
    for call in calls:
        if not isinstance(call.func, ast.Name):
            raise BackendError(f"cannot call {ast.unparse(call.func)[:40]!r}")
    return calls


def name_of(call: ast.Call) -> str:
    """Of the function that is called."""
    assert isinstance(call.func, ast.Name)
    return call.func.id


class Evaluator:
    """Works out expressions.

    Args:
        functions: what may be called inside them, by name.

    Attributes:
        variables: by name.
    """

    def __init__(self, functions: Mapping[str, Function]) -> None:
        self._functions = functions
        self.variables: dict[str, Value] = {}

    def arguments(self, call: ast.Call) -> tuple[list[Value], dict[str, Value]]:
        """Positional arguments and those by keyword."""
        named = {k.arg: self.value(k.value) for k in call.keywords if k.arg is not None}
        return [self.value(a) for a in call.args], named

    def value(self, node: ast.expr, depth: int = 0) -> Value:
        """What an expression is worth.

        Raises:
            BackendError: a kind of expression that is not supported, or a name that is not known.
        """
        if depth > _MAX_DEPTH:
            raise BackendError("an expression is nested too deeply")
        deeper = depth + 1
        if isinstance(node, ast.Constant) and isinstance(node.value, bool | int | float | str):
            return node.value
        if isinstance(node, ast.List):
            return [self.value(e, deeper) for e in node.elts]
        if isinstance(node, ast.Name):
            if node.id not in self.variables:
                raise BackendError(f"the variable {node.id!r} is not set")
            return self.variables[node.id]
        if isinstance(node, ast.Call):
            arguments, named = self.arguments(node)
            return self._functions[name_of(node)](*arguments, **named)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
            sign = -1 if isinstance(node.op, ast.USub) else 1
            return sign * number(self.value(node.operand, deeper))
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            return not self.value(node.operand, deeper)
        if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
            return self._binary(node, deeper)
        if isinstance(node, ast.Subscript):
            return self._subscript(node, deeper)
        raise BackendError(f"the expression {ast.unparse(node)[:60]!r} is not supported")

    def _binary(self, node: ast.BinOp, depth: int) -> Value:
        a, b = number(self.value(node.left, depth)), number(self.value(node.right, depth))
        try:
            return _BINARY[type(node.op)](a, b)
        except (ZeroDivisionError, OverflowError, ValueError) as error:
            raise BackendError(f"{ast.unparse(node)[:60]!r}: {error}") from None

    def _subscript(self, node: ast.Subscript, depth: int) -> Value:
        if isinstance(node.value, ast.Name) and node.value.id == "p" and isinstance(node.slice, ast.Tuple):
            return Pose(sixfold([self.value(e, depth) for e in node.slice.elts]))
        owner, index = self.value(node.value, depth), self.value(node.slice, depth)
        if isinstance(owner, list | Pose) and isinstance(index, int) and 0 <= index < len(owner):
            return owner[index]
        raise BackendError(f"the expression {ast.unparse(node)[:60]!r} has no value")


def number(value: Value) -> float:
    """A finite number.

    Raises:
        BackendError: it is none.
    """
    if isinstance(value, bool | int | float) and math.isfinite(value):
        return value
    raise BackendError(f"a number is needed, got {value!r:.60}")


def sixfold(value: Value | Sequence[Value]) -> list[float]:
    """Six finite numbers, of a list or pose.

    Raises:
        BackendError: they are not.
    """
    if isinstance(value, list | tuple) and len(value) == 6:
        return [float(number(v)) for v in value]
    raise BackendError(f"a list or pose of 6 numbers is needed, got {value!r:.60}")


def threefold(value: Value) -> list[float]:
    """Three finite numbers of a list.

    Raises:
        BackendError: they are not.
    """
    if isinstance(value, list) and len(value) == 3:
        return [float(number(v)) for v in value]
    raise BackendError(f"a list of 3 numbers is needed, got {value!r:.60}")


def text_of(value: Value) -> str:
    """As `textmsg` shows it."""
    if isinstance(value, Pose):
        return f"p[{', '.join(text_of(v) for v in value)}]"
    if isinstance(value, list):
        return f"[{', '.join(text_of(v) for v in value)}]"
    return f"{value:g}" if isinstance(value, float) else str(value)
