"""Short programs: one statement after the other, without branches, loops and threads."""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from cell.errors import BackendError
from hil.emulator.interfaces import Robot
from hil.emulator.motion.path import Leg
from hil.emulator.urscript.actions import ACTIONS
from hil.emulator.urscript.functions import functions
from hil.emulator.urscript.moves import MOVES, Targets
from hil.emulator.urscript.robot import Wait, mover_of, settle
from hil.emulator.urscript.values import Evaluator, called, name_of, parse

_HEAD = re.compile(r"^(def|sec)\s+(\w+)\s*\(\s*\)\s*:\s*$")
_ASSIGNMENT = re.compile(r"^(?:global\s+|local\s+)?([A-Za-z_]\w*)\s*=(?!=)\s*(.+)$", re.DOTALL)
_CONTROL = ("if", "elif", "else", "while", "for", "thread", "def", "return", "run", "kill", "join", "switch")
_CRITICAL = ("enter_critical", "exit_critical")
_MAX_STATEMENTS = 20_000
_NOT_BESIDE = (
    "sleep", "sync", "servoj", "speedj", "speedl", "stopj", "stopl", "force_mode", "end_force_mode",
    "freedrive_mode", "end_freedrive_mode", "teach_mode", "end_teach_mode", *MOVES,
)  # fmt: skip
"""What a secondary program may not do: it moves nothing and takes no time."""


@dataclass(frozen=True)
class Statement:
    """One line of a program.

    Attributes:
        text: as written. variable: set to the value; empty: none. node: what is worked out or called.
    """

    text: str
    variable: str
    node: ast.expr

    @property
    def call(self) -> ast.Call:
        """The call that it is; only of a statement that is one."""
        assert isinstance(self.node, ast.Call)
        return self.node

    @property
    def move(self) -> str:
        """Name of the move it is, or empty."""
        if isinstance(self.node, ast.Call) and not self.variable and name_of(self.node) in MOVES:
            return name_of(self.node)
        return ""


class ShortProgram:
    """Runs statements.

    Args:
        name: of its `def` line.

    Attributes:
        secondary: a `sec` program, which may run beside another one.
    """

    def __init__(self, name: str, statements: Sequence[Statement], secondary: bool = False) -> None:
        self.name, self.secondary = name, secondary
        self._statements = statements
        self._run: Wait | None = None

    def start(self, robot: Robot) -> None:
        self._run = run(robot, self._statements)

    def tick(self, robot: Robot) -> bool:
        del robot
        return self._run is not None and next(self._run, "over") is None

    def stop(self, robot: Robot) -> None:
        self._run = None


def run(robot: Robot, statements: Sequence[Statement]) -> Wait:
    """Statement by statement; moves in a row are one path, so that their blends work."""
    scope = Evaluator(functions(lambda: robot))
    at = 0
    while at < len(statements):
        statement = statements[at]
        at += 1
        if statement.move:
            moves = [statement]
            while at < len(statements) and statements[at].move:
                moves.append(statements[at])
                at += 1
            mover = mover_of(robot)
            mover.path(legs(robot, moves, scope))
            yield
            yield from settle(mover)
        elif statement.variable:
            scope.variables[statement.variable] = scope.value(statement.node)
        elif isinstance(statement.node, ast.Name):
            return  # halt
        else:
            arguments, named = scope.arguments(statement.call)
            action = ACTIONS.get(name_of(statement.call))
            if action is None:
                scope.value(statement.node)
            elif (waiting := action(robot, *arguments, **named)) is not None:
                yield from waiting


def legs(robot: Robot, moves: Sequence[Statement], scope: Evaluator) -> list[Leg]:
    """Move statements as what the mover takes."""
    targets, out = Targets(robot), []
    for statement in moves:
        arguments, named = scope.arguments(statement.call)
        out.append(MOVES[statement.move](targets, *arguments, **named))
    return out


def read(text: str) -> ShortProgram:
    """A program of a `def` or `sec` block, or of bare lines.

    Raises:
        BackendError: naming what cannot be run.
    """
    name, secondary, body = "unnamed", False, []
    lines = [line.strip() for line in _without_comments(text)]
    lines = [line for line in lines if line]
    if not lines:
        raise BackendError("the script is empty")
    if head := _HEAD.match(lines[0]):
        secondary, name = head[1] == "sec", head[2]
        if lines[-1] != "end":
            raise BackendError(f"the program {name!r} does not close with 'end'")
        lines = lines[1:-1]
    if len(lines) > _MAX_STATEMENTS:
        raise BackendError(f"a program may have {_MAX_STATEMENTS} statements, got {len(lines)}")
    for line in _joined(lines):
        if line not in _CRITICAL and line != "end":
            body.append(statement(line))
    for each in body if secondary else ():
        if isinstance(each.node, ast.Call) and name_of(each.node) in _NOT_BESIDE:
            raise BackendError(f"the secondary program {name!r} may not call {name_of(each.node)}()")
    return ShortProgram(name, body, secondary)


def statement(line: str) -> Statement:
    """One statement.

    Raises:
        BackendError: naming what cannot be run.
    """
    first = re.split(r"\W", line, maxsplit=1)[0]
    if first in _CONTROL:
        raise BackendError(f"{first!r} in {line[:60]!r}: programs with control flow cannot be run")
    assignment = _ASSIGNMENT.match(line)
    node = parse(assignment[2] if assignment else line)
    for call in called(node):
        _check(call, outermost=call is node and not assignment)
    halt = isinstance(node, ast.Name) and node.id == "halt"
    if not (assignment or halt or isinstance(node, ast.Call)):
        raise BackendError(f"{line[:80]!r} does nothing")
    return Statement(line, assignment[1] if assignment else "", node)


_KNOWN = functions(lambda: _no_robot())


def _no_robot() -> Robot:
    raise BackendError("there is no robot yet")


def _check(call: ast.Call, outermost: bool) -> None:
    """Whether there is such a function, and whether it takes such arguments."""
    name = name_of(call)
    function: Callable[..., object] | None = _KNOWN.get(name)
    extra: tuple[object, ...] = ()
    if outermost and function is None:
        function, extra = MOVES.get(name) or ACTIONS.get(name), (None,)
    if function is None:
        raise BackendError(f"the function {name}() cannot be run here")
    named: dict[str, object] = {k.arg: k for k in call.keywords if k.arg is not None}
    try:
        inspect.signature(function).bind(*extra, *call.args, **named)
    except TypeError as error:
        raise BackendError(f"{name}(): {error}") from None


def _without_comments(text: str) -> list[str]:
    out = []
    for line in text.splitlines():
        inside, kept = False, ""
        for char in line:
            if char == '"':
                inside = not inside
            if char == "#" and not inside:
                break
            kept += char
        out.append(kept)
    return out


def _joined(lines: Sequence[str]) -> list[str]:
    """Lines put together until their brackets close."""
    out: list[str] = []
    depth = 0
    for line in lines:
        out = [*out[:-1], f"{out[-1]} {line}"] if depth > 0 else [*out, line]
        plain = re.sub(r'"[^"]*"', "", line)
        depth += sum(plain.count(c) for c in "([") - sum(plain.count(c) for c in ")]")
    return out
