"""A number that is compared, with others in its place: whether any comparison would have come out otherwise.

Where a threshold only ever stands in comparisons (`gain > 2.0 * THRESHOLD * count`), a run in which every one of them
comes out the same with another value is the same run with that value: it need not be made. Whether it only stands
there is read from the syntax tree; a number that goes anywhere else is none of these.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

Key = tuple[str, float]  # of a number, and the factor by which it would be another
Operation = Callable[[Any, Any], Any]


def only_compared(trees: Sequence[ast.Module], name: str) -> bool:
    """Whether a name is read nowhere but in arithmetic that ends in a comparison."""
    for tree in trees:
        parents = {child: parent for parent in ast.walk(tree) for child in ast.iter_child_nodes(parent)}
        for node in parents:
            if isinstance(node, ast.Name) and node.id == name and isinstance(node.ctx, ast.Load):
                above = parents[node]
                while isinstance(above, ast.BinOp | ast.UnaryOp):
                    above = parents[above]
                if not isinstance(above, ast.Compare):
                    return False
            if isinstance(node, ast.Attribute) and node.attr == name:
                return False
    return True


class Watched:
    """A number and what it would be with other values; `otherwise` collects those with which a comparison differs."""

    __array_ufunc__ = None  # numpy leaves every operation with it to this class
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, value: Any, instead: Mapping[Key, Any], otherwise: set[Key]) -> None:
        self.value = value
        self.instead = instead
        self.otherwise = otherwise

    def _done(self, operation: Operation, other: Any, turned: bool = False) -> Watched:
        def with_other(value: Any, key: Key | None) -> Any:
            right = _at(other, key)
            return operation(right, value) if turned else operation(value, right)

        keys = {**self.instead, **(other.instead if isinstance(other, Watched) else {})}
        instead = {key: with_other(_at(self, key), key) for key in keys}
        return Watched(with_other(self.value, None), instead, self.otherwise)

    def _compared(self, operation: Operation, other: Any) -> Any:
        found = self._done(operation, other)
        self.otherwise |= {key for key, value in found.instead.items() if not np.array_equal(value, found.value)}
        return found.value

    def __lt__(self, other: Any) -> Any:
        return self._compared(operator.lt, other)

    def __le__(self, other: Any) -> Any:
        return self._compared(operator.le, other)

    def __gt__(self, other: Any) -> Any:
        return self._compared(operator.gt, other)

    def __ge__(self, other: Any) -> Any:
        return self._compared(operator.ge, other)

    def __eq__(self, other: object) -> Any:
        return self._compared(operator.eq, other)

    def __ne__(self, other: object) -> Any:
        return self._compared(operator.ne, other)

    def __neg__(self) -> Watched:
        return self._done(operator.mul, -1)

    def __add__(self, other: Any) -> Watched:
        return self._done(operator.add, other)

    def __sub__(self, other: Any) -> Watched:
        return self._done(operator.sub, other)

    def __mul__(self, other: Any) -> Watched:
        return self._done(operator.mul, other)

    def __truediv__(self, other: Any) -> Watched:
        return self._done(operator.truediv, other)

    def __pow__(self, other: Any) -> Watched:
        return self._done(operator.pow, other)

    def __radd__(self, other: Any) -> Watched:
        return self._done(operator.add, other, turned=True)

    def __rsub__(self, other: Any) -> Watched:
        return self._done(operator.sub, other, turned=True)

    def __rmul__(self, other: Any) -> Watched:
        return self._done(operator.mul, other, turned=True)

    def __rtruediv__(self, other: Any) -> Watched:
        return self._done(operator.truediv, other, turned=True)

    def __rpow__(self, other: Any) -> Watched:
        return self._done(operator.pow, other, turned=True)


def _at(number: Any, key: Key | None) -> Any:
    """A number as it is, or with another value of one of those that it is made of."""
    if not isinstance(number, Watched):
        return number
    return number.value if key is None else number.instead.get(key, number.value)
