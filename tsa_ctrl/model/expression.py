"""Parse a formula into a short program for a stack machine; it is bounded and never executed as Python.

    expression:  numbers, names, + - * / **, parentheses, sin cos tanh exp abs sign sqrt of one argument
                 lag(x, T), ring(x, f, d), dahl(x, w): functions with a memory (`filters`), whose x has no memory and
                 whose other arguments are constants
                 inside(x, low, high): 1 in that range and 0 far outside, for a formula that was learned there

The parser of Python converts the text to a tree. Only the nodes above are accepted; everything else is rejected. The
program is data. Model, controller and plant evaluate it with a stack machine that has only the operations of `Op`.
"""

from __future__ import annotations

import ast
import difflib
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, TypeAlias

import numpy as np

from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.filters import KINDS, Live, Memory, usage
from tsa_ctrl.model.functions import BLOCK, LARGEST, SCALARS, Array, F

LONGEST = 500  # characters: a formula that a person can still read
MOST_STEPS = 120  # operations; they take about 20 us on the controller's machine, a fiftieth of a cycle at 1 kHz
DEEPEST = 24  # levels of nesting; the stack of the plant's machine is deeper
MOST_MEMORIES = 4  # each one is a dimension of the grid on which the inverse is checked


class Op(IntEnum):
    """List the operations of the steps of a program."""

    CONSTANT = 0  # push the step's number
    NAME = 1  # push the value of the step's name
    ADD = 2
    SUBTRACT = 3
    MULTIPLY = 4
    DIVIDE = 5
    POWER = 6
    NEGATE = 7
    SIN = 8
    COS = 9
    TANH = 10
    EXP = 11
    ABS = 12
    SIGN = 13
    SQRT = 14
    LAG = 15  # from here on, functions with a memory, whose index is the argument
    RING = 16
    DAHL = 17


INSIDE = "inside"  # inside(x, low, high) = (1 - tanh(STEEP (|x - middle|/half - FADED)))/2
FADED, STEEP = 1.25, 12.0  # half widths at which it is 1/2, and its steepness (0.998 at the ends, 0.002 at 1.5)
FUNCTIONS = {op.name.lower(): op for op in (Op.SIN, Op.COS, Op.TANH, Op.EXP, Op.ABS, Op.SIGN, Op.SQRT)}
REMEMBERING = {kind: Op[kind.upper()] for kind in KINDS}
Remember: TypeAlias = Callable[[int, F], F]  # returns the value of a memory from its index and its x
_BINARY: dict[type[ast.operator], Op] = {
    ast.Add: Op.ADD,
    ast.Sub: Op.SUBTRACT,
    ast.Mult: Op.MULTIPLY,
    ast.Div: Op.DIVIDE,
    ast.Pow: Op.POWER,
}


@dataclass(frozen=True)
class Program:
    """Hold the steps in reverse Polish order: `operations` (k) and `arguments` (k).

    An argument is a constant, an index into `names`, or for a function with a memory an index into `memories`.
    """

    text: str
    names: tuple[str, ...]
    operations: tuple[int, ...]
    arguments: tuple[float, ...]
    memories: tuple[Memory, ...] = ()

    def uses(self, name: str) -> bool:
        """Return True if the formula's value may depend on `name`."""
        return any(
            op == Op.NAME and self.names[int(index)] == name
            for op, index in zip(self.operations, self.arguments, strict=True)
        )

    def value(self, values: Sequence[float], memories: Sequence[Live] = ()) -> float:
        """Return the formula at one instant, with `values` in the order of `names`; nan if undefined.

        `memories`: the memories of the program in a control loop.
        """
        return self._run(values, _SCALARS, lambda index, x: memories[index].value(x))

    def array(self, values: Sequence[Array], remember: Remember[Array] | None = None) -> Array:
        """Return the formula over a log, with `values` in the order of `names`, each (n) or 0-dimensional.

        `remember`: required if the program has memories.
        """
        with np.errstate(all="ignore"):
            return np.asarray(self._run(values, _ARRAYS, remember))

    def _run(self, values: Sequence[F], functions: Mapping[int, Callable[..., F]], remember: Remember[F] | None) -> F:
        """Return the result of the stack machine."""
        stack: list[Any] = []
        for op, argument in zip(self.operations, self.arguments, strict=True):
            if op == Op.CONSTANT:
                stack.append(argument)
            elif op == Op.NAME:
                stack.append(values[int(argument)])
            elif op <= Op.POWER:
                right = stack.pop()
                stack.append(functions[op](stack.pop(), right))
            elif op >= Op.LAG:
                assert remember is not None
                stack.append(remember(int(argument), stack.pop()))
            else:
                stack.append(functions[op](stack.pop()))
        result: F = stack[0]
        return result

    def over(self, values: Sequence[Array], t: Array) -> Array:
        """Return `array` along a log, with memories that start at its first sample; t in s, (n,)."""
        if not self.memories:
            out = np.empty(t.shape)
            for start in range(0, len(t), BLOCK):
                block = slice(start, start + BLOCK)
                out[block] = self.array([value[block] if value.ndim else value for value in values])
            return out
        return self.array(values, lambda index, x: self.memories[index].over(np.broadcast_to(x, t.shape), t))


def parse(text: str, names: Sequence[str], constants: Mapping[str, float], where: str) -> Program:
    """Return the program of a formula; raises UsageError with a message of one line.

    Args:
        text: the formula.
        names: permitted variables.
        constants: parameters by name, inserted as numbers.
        where: start of the message of an error.
    """
    if len(text) > LONGEST:
        raise UsageError(f"{where}: {len(text)} characters; at most {LONGEST} are allowed: shorten the formula")
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        reason = error.msg if isinstance(error, SyntaxError) else "nested too deeply"
        raise UsageError(f"{where}: '{text}' is not a formula ({reason}); write for example k*sin(2*q_j)") from None
    operations: list[int] = []
    arguments: list[float] = []
    memories: list[Memory] = []

    def add(op: Op, argument: float = 0.0) -> None:
        operations.append(int(op))
        arguments.append(argument)

    def read(node: ast.expr, depth: int, within: str = "") -> None:
        if depth > DEEPEST or len(operations) >= MOST_STEPS:
            raise UsageError(f"{where}: more than {MOST_STEPS} steps or {DEEPEST} levels; shorten the formula")
        match node:
            case ast.Constant(value=bool()):
                raise _refused(text, node, where)
            case ast.Constant(value=int() | float() as value):
                if not math.isfinite(float(value)):
                    raise UsageError(f"{where}: {value} is not a finite number")
                add(Op.CONSTANT, float(value))
            case ast.Name(id=name) if name in constants:
                add(Op.CONSTANT, constants[name])
            case ast.Name(id=name) if name in names:
                add(Op.NAME, float(names.index(name)))
            case ast.Name(id=name):
                known = [*names, *constants, *FUNCTIONS, *REMEMBERING, INSIDE]
                near = difflib.get_close_matches(name, known, n=1)
                advice = f"did you mean '{near[0]}'?" if near else f"available: {', '.join(known)}"
                raise UsageError(f"{where}: '{name}' is neither a signal nor a parameter; {advice}")
            case ast.BinOp(left=left, op=operator, right=right) if type(operator) in _BINARY:
                read(left, depth + 1, within)
                read(right, depth + 1, within)
                add(_BINARY[type(operator)])
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                read(operand, depth + 1, within)
                add(Op.NEGATE)
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                read(operand, depth + 1, within)
            case ast.Call(func=ast.Name(id=function), args=[argument], keywords=[]) if function in FUNCTIONS:
                read(argument, depth + 1, within)
                add(FUNCTIONS[function])
            case ast.Call(func=ast.Name(id=function), args=[argument, *ends], keywords=[]) if function == INSIDE:
                low, high = _range(ends, constants, f"{where}: '{_source(text, node)}'")
                add(Op.CONSTANT, 0.5)
                add(Op.CONSTANT, 0.5)
                read(argument, depth + 3, within)
                for number, op in ((0.5 * (low + high), Op.SUBTRACT), (None, Op.ABS), (0.5 * (high - low), Op.DIVIDE)):
                    if number is not None:
                        add(Op.CONSTANT, number)
                    add(op)
                for number, op in ((FADED, Op.SUBTRACT), (STEEP, Op.MULTIPLY)):
                    add(Op.CONSTANT, number)
                    add(op)
                for op in (Op.TANH, Op.MULTIPLY, Op.SUBTRACT):
                    add(op)
            case ast.Call(func=ast.Name(id=kind), args=given, keywords=[]) if kind in KINDS:
                if within:
                    raise UsageError(
                        f"{where}: {kind} within {within}; functions with a memory cannot be nested: write them "
                        "separately"
                    )
                memory = _memory(kind, given, constants, f"{where}: '{_source(text, node)}'")
                read(given[0], depth + 1, kind)
                add(REMEMBERING[kind], float(len(memories)))
                memories.append(memory)
                if len(memories) > MOST_MEMORIES:
                    raise UsageError(f"{where}: more than {MOST_MEMORIES} functions with a memory; use fewer")
            case _:
                raise _refused(text, node, where)

    try:
        read(tree, 0)
    except OverflowError:
        raise UsageError(f"{where}: '{text}' has a number that is too large") from None
    return Program(text, tuple(names), tuple(operations), tuple(arguments), tuple(memories))


def _range(given: Sequence[ast.expr], constants: Mapping[str, float], where: str) -> tuple[float, float]:
    """Return the two ends of inside(x, low, high); raises UsageError."""
    ends = [_constant(node, constants) for node in given]
    if len(ends) != 2 or ends[0] is None or ends[1] is None or not -math.inf < ends[0] < ends[1] < math.inf:
        raise UsageError(f"{where}: write {INSIDE}(x, low, high) with two constants, low < high")
    return ends[0], ends[1]


def _memory(kind: str, given: Sequence[ast.expr], constants: Mapping[str, float], where: str) -> Memory:
    """Return a function with a memory from its constants; raises UsageError."""
    ranges = KINDS[kind]
    if len(given) != 1 + len(ranges):
        raise UsageError(f"{where}: found {len(given)} argument(s); write {usage(kind)}")
    values = []
    for allowed, node in zip(ranges, given[1:], strict=True):
        value = _constant(node, constants)
        if value is None:
            raise UsageError(f"{where}: {allowed.name} is not a constant; give a number or a key of the table")
        if not allowed.low <= value <= allowed.high:
            raise UsageError(f"{where}: {allowed.name} = {value:g}; allowed is {allowed.describe()}")
        values.append(value)
    return Memory(kind, tuple(values))


def _constant(node: ast.expr, constants: Mapping[str, float]) -> float | None:
    """Return the value of a number or a named constant, with its sign; None for anything else."""
    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            return float(value)
        case ast.Name(id=name) if name in constants:
            return constants[name]
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            positive = _constant(operand, constants)
            return None if positive is None else -positive
    return None


def _source(text: str, node: ast.expr) -> str:
    return ast.get_source_segment(text.strip(), node) or text


def _refused(text: str, node: ast.expr, where: str) -> UsageError:
    return UsageError(
        f"{where}: '{_source(text, node)}' is not allowed; allowed are numbers, names, + - * / **, "
        f"{' '.join(FUNCTIONS)} of one argument, {INSIDE}(x, low, high), and {', '.join(map(usage, KINDS))}"
    )


def _divided(left: float, right: float) -> float:
    return left / right if right else math.nan


def _raised(left: float, right: float) -> float:
    try:
        power = left**right
    except ZeroDivisionError:
        return math.nan
    except OverflowError:
        return math.inf
    return power if isinstance(power, float) else math.nan


def _quotient(left: Array, right: Array) -> Array:
    return np.where(right == 0.0, np.nan, np.divide(left, right))


def _power(left: Array, right: Array) -> Array:
    return np.where((left == 0.0) & (right < 0.0), np.nan, np.power(left, right))


# Single numbers saturate instead of raising errors. Both kinds are nan where a formula is undefined.
_SCALARS: dict[int, Callable[..., float]] = {
    Op.ADD: operator.add,
    Op.SUBTRACT: operator.sub,
    Op.MULTIPLY: operator.mul,
    Op.DIVIDE: _divided,
    Op.POWER: _raised,
    Op.NEGATE: operator.neg,
    Op.SIN: SCALARS.sin,
    Op.COS: lambda x: math.cos(x) if math.isfinite(x) else math.nan,
    Op.TANH: math.tanh,
    Op.EXP: lambda x: SCALARS.exp(x) if x == x else x,
    Op.ABS: abs,
    Op.SIGN: lambda x: SCALARS.sign(x) if x == x else x,
    Op.SQRT: lambda x: math.sqrt(x) if x >= 0.0 else math.nan,
}
_ARRAYS: dict[int, Callable[..., Array]] = {
    Op.ADD: np.add,
    Op.SUBTRACT: np.subtract,
    Op.MULTIPLY: np.multiply,
    Op.DIVIDE: _quotient,
    Op.POWER: _power,
    Op.NEGATE: np.negative,
    Op.SIN: np.sin,
    Op.COS: np.cos,
    Op.TANH: np.tanh,
    Op.EXP: lambda x: np.exp(np.minimum(x, LARGEST)),
    Op.ABS: np.abs,
    Op.SIGN: np.sign,
    Op.SQRT: np.sqrt,
}
