"""What the arrays of a file must be, declared as a table of rules, and the one check of all of them.

    RULES = {
        "gains": Rule(("P", 8)),                            # binds the size P
        "part": Rule(("N",), np.uint8, below="P"),          # indices into what has P rows
        "weight": Rule(("N", "K"), low=0, tests=(sums_to_one(1e-3),)),
    }
    arrays = checked(arrays, RULES, "anna.gavatar: mine.npz", sizes={"N": 5000})

Rules are applied in their order, so that a size is bound before another rule counts on it.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Mapping

import numpy as np

from ..errors import UserError

ADVICE = "export it again"
HUGE = 1e6  # a number beyond is none of ours, and products of three of them stay far from float32's end
FAR = 1e4  # metres: beyond, float32 rounds by more than a millimetre
KINDS = {"f": "real numbers", "i": "whole numbers", "b": "true or false", "U": "text"}
_BASES = {"f": np.floating, "i": np.integer, "b": np.bool_, "U": np.str_}

Test = Callable[[np.ndarray], str]  # what is wrong with an array, '' if nothing is


@dataclasses.dataclass(frozen=True)
class Rule:
    """What one array must be.

    shape: a number, the name of a size, or a product of both as `9 J` for each axis; `?` is any number. A name not yet
    known is bound to what the array has. dtype: what it becomes, from any width of the same kind; `np.floating` and
    `np.integer` leave the width as it is. low, high: the least and the largest value there may be; real numbers are
    kept within 1e6 unless these say more. below: indices from 0 up to a size, written as in `shape`. finite: False lets
    anything pass that is of the kind. optional: may be missing. beside: names of arrays without which this one may not
    be. empty: may have no entry. size: the name of the size that a single number gives. tests: of what else must hold.
    """

    shape: tuple[int | str, ...]
    dtype: type = np.float32
    low: float | None = None
    high: float | None = None
    below: str = ""
    finite: bool = True
    optional: bool = False
    beside: tuple[str, ...] = ()
    empty: bool = False
    size: str = ""
    tests: tuple[Test, ...] = ()


def checked(
    arrays: Mapping[str, np.ndarray],
    rules: Mapping[str, Rule],
    source: str,
    *,
    sizes: Mapping[str, int] | None = None,
    prefix: str = "",
) -> dict[str, np.ndarray]:
    """The arrays that have a rule, each of its rule's dtype.

    rules: by the arrays' names, or by a pattern of names, as `weight_\\d+`. prefix: before every name in the file, left
    out of the result. sizes: known ones. Raises UserError naming source and array for the first that breaks its rule.
    """
    known, found = dict(sizes or {}), {}
    for pattern, rule in rules.items():
        names = [n for n in arrays if n.startswith(prefix) and re.fullmatch(pattern, n[len(prefix) :])]
        if not names and not rule.optional:
            raise lacking(source, prefix + pattern)
        for name in names:
            absent = [other for other in rule.beside if prefix + other not in arrays]
            if absent:
                raise lacking(source, prefix + absent[0])
            try:
                found[name[len(prefix) :]] = _obeying(np.asarray(arrays[name]), rule, known)
            except _Fault as fault:
                raise UserError(f"{source}: array '{name}' {fault}; {ADVICE}") from None
    return found


def lacking(source: str, name: str) -> UserError:
    """What to raise for an array that is not there."""
    return UserError(f"{source} lacks the array '{name}'; {ADVICE}")


class _Fault(Exception):
    """What is wrong with an array, as the rest of a sentence that begins with its name."""


def _obeying(array: np.ndarray, rule: Rule, sizes: dict[str, int]) -> np.ndarray:
    wanted = _kind(rule.dtype)
    if {"u": "i"}.get(array.dtype.kind, array.dtype.kind) != wanted:
        raise _Fault(f"holds {array.dtype}, expected {KINDS[wanted]}")
    _check_shape(array.shape, rule.shape, sizes)
    if not array.size:
        if not rule.empty:
            raise _Fault("is empty")
        return array.astype(rule.dtype) if _has_width(rule.dtype) else array
    if wanted == "i":
        _check_whole(array, rule, sizes)
    if _has_width(rule.dtype):
        with np.errstate(over="ignore", invalid="ignore"):  # infinity is told below
            array = array.astype(rule.dtype, copy=False)
    if wanted == "f" and rule.finite:
        _check_real(array, rule)
    if rule.size:
        sizes[rule.size] = int(array)
    for fault in (test(array) for test in rule.tests):
        if fault:
            raise _Fault(fault)
    return array


def _kind(dtype: type) -> str:
    return next(kind for kind, base in _BASES.items() if issubclass(dtype, base))


def _has_width(dtype: type) -> bool:
    return dtype not in _BASES.values() or dtype is np.bool_


def _check_shape(shape: tuple[int, ...], axes: tuple[int | str, ...], sizes: dict[str, int]) -> None:
    fits = len(shape) == len(axes)
    for length, axis in zip(shape, axes, strict=False):
        if axis == "?" or not fits:
            continue
        product, unknown = _product(axis, sizes)
        if not unknown:
            fits = length == product
        elif len(unknown) == 1 and length % product == 0:
            sizes[unknown[0]] = length // product
        else:
            fits = False
    if not fits:
        expected = ", ".join(str(a) if _product(a, sizes)[1] else str(_product(a, sizes)[0]) for a in axes)
        raise _Fault(f"has shape {shape}, not ({expected}{',' if len(axes) == 1 else ''})")


def _product(axis: int | str, sizes: Mapping[str, int]) -> tuple[int, list[str]]:
    """The product of what is known of an axis, and the names of what is not."""
    product, unknown = 1, []
    for factor in str(axis).split():
        if factor.isdigit():
            product *= int(factor)
        elif factor in sizes:
            product *= sizes[factor]
        else:
            unknown.append(factor)
    return product, unknown


def _check_whole(array: np.ndarray, rule: Rule, sizes: Mapping[str, int]) -> None:
    low, high = int(array.min()), int(array.max())
    if rule.below:
        limit = _product(rule.below, sizes)[0]
        if low < 0 or high >= limit:
            raise _Fault(f"points outside 0 to {limit - 1}")
    _check_range(low, high, rule.low, rule.high)
    if _has_width(rule.dtype):
        room = np.iinfo(rule.dtype)
        _check_range(low, high, room.min, room.max)


def _check_real(array: np.ndarray, rule: Rule) -> None:
    low, high = float(array.min()), float(array.max())  # both NaN if any is
    if not (np.isfinite(low) and np.isfinite(high)):
        raise _Fault("holds NaN or infinity")
    _check_range(low, high, -HUGE if rule.low is None else rule.low, HUGE if rule.high is None else rule.high)


def _check_range(low: float, high: float, least: float | None, most: float | None) -> None:
    if least is not None and low < least:
        raise _Fault(f"holds {low:.6g}, less than {least:g}")
    if most is not None and high > most:
        raise _Fault(f"holds {high:.6g}, more than {most:g}")


def sums_to_one(tolerance: float) -> Test:
    """That the last axis sums to 1, as weights do that say how much each of several things counts."""

    def test(array: np.ndarray) -> str:
        sums = array.sum(-1, dtype=np.float64).reshape(-1)
        worst = sums[np.argmax(np.abs(sums - 1))]
        return f"has weights that sum to {worst:.4g}, not 1" if abs(worst - 1) > tolerance else ""

    return test


def a_tree(parents: np.ndarray) -> str:
    """That each joint's parent stands before it, and the first joint alone has none (-1)."""
    wrong = np.flatnonzero((parents >= np.arange(len(parents))) | ((parents < 0) != (np.arange(len(parents)) == 0)))
    if not len(wrong):
        return ""
    return f"is no skeleton: joint {wrong[0]} has the parent {parents[wrong[0]]}"


def rigid(T: np.ndarray) -> str:
    """That (J, 4, 4) matrices rotate and translate, to 1e-3: their inverses are taken by transposition."""
    R = T[:, :3, :3]
    off = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max((1, 2))
    bad = ~((off < 1e-3) & (np.linalg.det(R) > 0) & (np.abs(T[:, 3] - [0, 0, 0, 1]).max(1) < 1e-3))
    return f"is no rigid transform at joint {int(np.argmax(bad))}" if bad.any() else ""


def ascending(values: np.ndarray) -> str:
    """That each number is larger than the one before."""
    return "" if (np.diff(values) > 0).all() else "does not ascend"


def all_different(values: np.ndarray) -> str:
    """That no two entries are the same."""
    found, counts = np.unique(values, return_counts=True)
    return f"holds '{found[np.argmax(counts)]}' {counts.max()} times" if (counts > 1).any() else ""


def a_permutation(values: np.ndarray) -> str:
    """That every number from 0 up to their count is there once."""
    if np.array_equal(np.sort(values), np.arange(len(values))):
        return ""
    return f"is no order of {len(values)} things: a place is given twice"
