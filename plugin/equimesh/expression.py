"""Arithmetic in x and y, read from text and differentiated symbolically.

The text is parsed, never executed: Python's own grammar gives a syntax tree, and every node of that
tree must stand in a short list. What passes becomes a SymPy expression whose derivatives up to the
third are compiled to NumPy when they are first asked for.
"""

from __future__ import annotations

import ast
import functools
import math
import operator
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import scipy
import sympy
from numpy.typing import ArrayLike, NDArray
from sympy.printing.numpy import SciPyPrinter

from equimesh.errors import InputError

__all__ = ["Expression", "parse"]

Array = NDArray[np.float64]

MAX_LENGTH = 4000  # characters
MAX_DEPTH = 40  # nested brackets, functions and powers
MAX_EXPONENT = 1000
MAX_OPERATIONS = 20_000  # in a derivative, before common parts are shared
EXACT = 2**53  # whole numbers up to here are doubles

X, Y = sympy.Symbol("x"), sympy.Symbol("y")

ALLOWED = (
    "numbers, x, y, pi, e, + - * / ** and sin cos tan asin acos atan atan2 sinh cosh tanh exp log "
    "log10 sqrt hypot erf abs sign min max"
)


class _Kink(sympy.Function):  # type: ignore[misc]
    """A function that NumPy evaluates and that SymPy leaves alone but for its derivative."""

    def _numpycode(self, printer: _Printer) -> str:
        return f"{type(self).__name__}({', '.join(map(printer._print, self.args))})"


class _Step(_Kink):
    """1 where its argument is not negative, else 0; its derivative is taken as 0 everywhere."""

    nargs = 1

    def fdiff(self, argindex: int = 1) -> sympy.Expr:
        return sympy.Integer(0)


class _Sign(_Step):
    """-1, 0 or 1."""


class _Abs(_Kink):
    """|u|, with derivative sign(u) and no impulse behind it."""

    nargs = 1

    def fdiff(self, argindex: int = 1) -> sympy.Expr:
        return _Sign(self.args[0])


class _Max(_Kink):
    """The larger of two, with the derivative of whichever is larger."""

    nargs = 2

    def fdiff(self, argindex: int = 1) -> sympy.Expr:
        first, second = self.args
        step = _Step(first - second)
        return step if argindex == 1 else 1 - step


_NUMERIC: dict[str, Callable[..., Any]] = {
    "_Step": lambda u: np.where(u >= 0, 1.0, 0.0) + 0.0 * u,
    "_Sign": np.sign,
    "_Abs": np.abs,
    "_Max": np.maximum,
    "erf": lambda u: scipy.special.erf(u),  # looked up when called: scipy.special is slow to load
}


class _Printer(SciPyPrinter):  # type: ignore[misc]
    """Numbers print as the nearest double, so that no digit is lost and no integer overflows."""

    def _print_Float(self, expr: sympy.Float) -> str:
        return repr(float(expr))

    def _print_Integer(self, expr: sympy.Integer) -> str:
        return str(int(expr)) if abs(int(expr)) <= MAX_EXPONENT else repr(float(expr))

    def _print_Rational(self, expr: sympy.Rational) -> str:
        return repr(float(expr))


@dataclass(frozen=True)
class _Named:
    """A function that text may call: on symbols, on plain numbers, with this many arguments."""

    symbolic: Callable[..., sympy.Expr]
    numeric: Callable[..., float]
    least: int = 1
    most: int = 1


def _largest(*args: sympy.Expr) -> sympy.Expr:
    return functools.reduce(_Max, args)


def _smallest(*args: sympy.Expr) -> sympy.Expr:
    return -_largest(*(-arg for arg in args))


_FUNCTIONS: dict[str, _Named] = {
    "sin": _Named(sympy.sin, math.sin),
    "cos": _Named(sympy.cos, math.cos),
    "tan": _Named(sympy.tan, math.tan),
    "asin": _Named(sympy.asin, math.asin),
    "acos": _Named(sympy.acos, math.acos),
    "atan": _Named(sympy.atan, math.atan),
    "atan2": _Named(sympy.atan2, math.atan2, 2, 2),
    "sinh": _Named(sympy.sinh, math.sinh),
    "cosh": _Named(sympy.cosh, math.cosh),
    "tanh": _Named(sympy.tanh, math.tanh),
    "exp": _Named(sympy.exp, math.exp),
    "log": _Named(sympy.log, math.log),
    "log10": _Named(lambda u: sympy.log(u) / sympy.Float(math.log(10)), math.log10),
    "sqrt": _Named(sympy.sqrt, math.sqrt),
    "hypot": _Named(lambda u, v: sympy.sqrt(u**2 + v**2), math.hypot, 2, 2),
    "erf": _Named(sympy.erf, math.erf),
    "abs": _Named(_Abs, abs),
    "sign": _Named(_Sign, lambda u: math.copysign(1.0, u) if u else 0.0),
    "min": _Named(_smallest, min, 2, 20),
    "max": _Named(_largest, max, 2, 20),
}

_NAMES: dict[str, sympy.Expr] = {
    "x": X,
    "y": Y,
    "pi": sympy.Float(math.pi),
    "e": sympy.Float(math.e),
}


@dataclass(frozen=True)
class Expression:
    """A smooth function of x and y with exact derivatives.

    Every method takes two arrays that broadcast to a common shape ``s`` and answers in float64;
    where the formula has no real value (``log`` of a negative number) the answer is NaN.

    >>> f = parse("x^2 * y")
    >>> f.value([1.0, 2.0], 3.0)
    array([ 3., 12.])
    >>> f.gradient(1.0, 3.0)
    array([6., 1.])
    """

    text: str
    formula: sympy.Expr

    def __call__(self, x: ArrayLike, y: ArrayLike) -> Array:
        """The same as ``value``, so that an expression stands wherever a callable does."""
        return self.value(x, y)

    def value(self, x: ArrayLike, y: ArrayLike) -> Array:
        """(*s,) heights."""
        return _evaluate(self._compiled[0], x, y)[..., 0]

    def gradient(self, x: ArrayLike, y: ArrayLike) -> Array:
        """(*s, 2): f_x, f_y."""
        return _evaluate(self._compiled[1], x, y)

    def hessian(self, x: ArrayLike, y: ArrayLike) -> Array:
        """(*s, 2, 2): f_xx, f_xy; f_xy, f_yy."""
        second = _evaluate(self._compiled[2], x, y)
        return second[..., [[0, 1], [1, 2]]]

    def third(self, x: ArrayLike, y: ArrayLike) -> Array:
        """(*s, 4): f_xxx, f_xxy, f_xyy, f_yyy."""
        return _evaluate(self._compiled[3], x, y)

    @functools.cached_property
    def _compiled(self) -> _Derivatives:
        return _Derivatives(self.formula)


class _Derivatives:
    """The derivatives of each order, symbolic and compiled, made when first asked for."""

    def __init__(self, formula: sympy.Expr) -> None:
        self.symbolic: list[list[sympy.Expr]] = [[formula]]
        self.functions: dict[int, Callable[[Array, Array], list[Any]]] = {}

    def __getitem__(self, order: int) -> Callable[[Array, Array], list[Any]]:
        if order not in self.functions:
            self.functions[order] = sympy.lambdify(
                (X, Y), self._terms(order), modules=[_NUMERIC, "numpy"],
                printer=_Printer({"fully_qualified_modules": False}), cse=True,
            )  # fmt: skip
        return self.functions[order]

    def _terms(self, order: int) -> list[sympy.Expr]:
        """d^order f / dx^(order - i) dy^i for i = 0 .. order."""
        while len(self.symbolic) <= order:
            last = self.symbolic[-1]
            terms = [sympy.diff(term, X) for term in last] + [sympy.diff(last[-1], Y)]
            if sum(sympy.count_ops(term) for term in terms) > MAX_OPERATIONS:
                raise InputError(
                    "The expression has too long derivatives: give a shorter one, or a Python "
                    "callable with its own gradient and Hessian."
                )
            self.symbolic.append(terms)
        return self.symbolic[order]


def _evaluate(function: Callable[[Array, Array], list[Any]], x: ArrayLike, y: ArrayLike) -> Array:
    xs, ys = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
    with np.errstate(all="ignore"):
        terms = function(xs, ys)
    # A constant term comes back as a scalar.
    return np.stack([np.broadcast_to(np.asarray(term, np.float64), xs.shape) for term in terms], -1)


def parse(text: str) -> Expression:
    """Read arithmetic in x and y; ``^`` means power.

    Raises InputError, naming the part that is not allowed, for anything else.

    >>> parse("exp(5*x) * sin(5*y)").value([0.0, 1.0], 0.0)
    array([0., 0.])
    >>> parse("open('x')")
    Traceback (most recent call last):
    equimesh.errors.InputError: The expression may not call 'open': allowed are numbers, ...
    """
    if len(text) > MAX_LENGTH:
        raise InputError(
            f"The expression has {len(text)} characters: at most {MAX_LENGTH} are allowed."
        )
    if not text.strip():
        raise InputError("The expression is empty: give one such as exp(5*x)*sin(5*y).")
    try:
        # ^ binds more loosely than + in Python: it must become ** before parsing, not after.
        tree = ast.parse(text.strip().replace("^", "**"), mode="eval")
    except (SyntaxError, ValueError, MemoryError, RecursionError):
        raise InputError(
            f"The expression {_shortened(text)} is not arithmetic that can be read: check its "
            "brackets and write products with *, as in 2*x."
        ) from None
    return Expression(text, _build(tree.body, 0))


def _build(node: ast.expr, depth: int) -> sympy.Expr:
    if depth > MAX_DEPTH:
        raise InputError(
            f"The expression is nested more than {MAX_DEPTH} levels deep: simplify it."
        )
    match node:
        case ast.Constant(value=bool() | complex() | str() | bytes() | None):
            raise _refusal("contain", node)
        case ast.Constant(value=int() | float() as value):
            return _number(value)
        case ast.Name() if node.id in _NAMES:
            return _NAMES[node.id]
        case ast.UnaryOp(op=ast.UAdd()):
            return _build(node.operand, depth + 1)
        case ast.UnaryOp(op=ast.USub()):
            return -_build(node.operand, depth + 1)
        case ast.BinOp(op=ast.Add() | ast.Sub()):
            return _checked(sympy.Add(*_chain(node, ast.Add, ast.Sub, operator.neg, depth)))
        case ast.BinOp(op=ast.Mult() | ast.Div()):
            return _checked(sympy.Mul(*_chain(node, ast.Mult, ast.Div, _inverse, depth)))
        case ast.BinOp(op=ast.Pow()):
            return _power(_build(node.left, depth + 1), _build(node.right, depth + 1))
        case ast.Call():
            return _call(node, depth)
    raise _refusal("contain", node)


def _chain(
    node: ast.expr,
    plain: type[ast.operator],
    other: type[ast.operator],
    undo: Callable[[sympy.Expr], sympy.Expr],
    depth: int,
) -> list[sympy.Expr]:
    """The terms of a - b + c ..., or the factors of a / b * c ..., however many there are."""
    terms = []
    while isinstance(node, ast.BinOp) and isinstance(node.op, plain | other):
        term = _build(node.right, depth + 1)
        terms.append(undo(term) if isinstance(node.op, other) else term)
        node = node.left
    terms.append(_build(node, depth + 1))
    return terms[::-1]


def _inverse(term: sympy.Expr) -> sympy.Expr:
    if term.is_number and term == 0:
        raise InputError("The expression divides by zero.")
    return 1 / term


def _call(node: ast.Call, depth: int) -> sympy.Expr:
    name = node.func.id if isinstance(node.func, ast.Name) else ""
    if name not in _FUNCTIONS:
        raise _refusal("call", node.func)
    named = _FUNCTIONS[name]
    if node.keywords or any(isinstance(arg, ast.Starred) for arg in node.args):
        raise _refusal("contain", node)
    if not named.least <= len(node.args) <= named.most:
        wanted = {1: "one argument", 2: "two arguments"}.get(named.most, "2 to 20 arguments")
        raise InputError(f"In the expression {name} needs {wanted}, not {len(node.args)}.")
    args = [_build(arg, depth + 1) for arg in node.args]
    if all(arg.is_Number for arg in args):
        return _folded(named.numeric, *args)
    return _checked(named.symbolic(*args))


def _power(base: sympy.Expr, exponent: sympy.Expr) -> sympy.Expr:
    if base.is_Number and exponent.is_Number:
        return _folded(operator.pow, base, exponent)
    if exponent.is_Float and float(exponent).is_integer():
        exponent = sympy.Integer(int(exponent))  # x ** 2.0 is x ** 2
    _check_exponent(exponent)
    return _checked(base**exponent)


def _check_exponent(exponent: sympy.Expr) -> None:
    if exponent.is_Number and abs(exponent) > MAX_EXPONENT:
        raise InputError(
            f"The expression has an exponent above {MAX_EXPONENT}: give a smaller one."
        )


def _checked(formula: sympy.Expr) -> sympy.Expr:
    """The formula with sane exponents and with long integers as doubles.

    This holds after every step, so that a single step starts from short numbers and stays cheap.
    """
    for power in formula.atoms(sympy.Pow):
        _check_exponent(power.exp)
    if formula.has(sympy.I, sympy.nan, sympy.zoo, sympy.oo, -sympy.oo):
        raise _no_real_value()
    long = {
        number: _double(float(number))
        for number in formula.atoms(sympy.Rational)
        if max(abs(number.p), number.q) > EXACT
    }
    return formula.xreplace(long) if long else formula


def _number(value: int | float) -> sympy.Expr:
    """A literal; exact where that is short, as 0.1 = 1/10."""
    if isinstance(value, int):
        return sympy.Integer(value) if value <= EXACT else _double(value)
    if not math.isfinite(value):
        return _double(value)
    exact = Fraction(repr(value))
    if max(exact.numerator, exact.denominator) <= EXACT:
        return sympy.Rational(exact.numerator, exact.denominator)
    return _double(value)


def _folded(function: Callable[..., float], *args: sympy.Expr) -> sympy.Expr:
    """A function of plain numbers as a number."""
    try:
        result = function(*(float(arg) for arg in args))
    except OverflowError:
        result = math.inf
    except (ValueError, ZeroDivisionError):
        result = math.nan
    if isinstance(result, complex) or math.isnan(result):
        raise _no_real_value()
    return _number(int(result)) if float(result).is_integer() else _double(result)


def _double(value: float) -> sympy.Expr:
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise InputError("The expression has a number above 1e308: give a smaller one.")
    return sympy.Float(number)


def _no_real_value() -> InputError:
    return InputError(
        "The expression has a part without a real value, such as sqrt(-1) or 0**-1: correct it."
    )


def _refusal(verb: str, node: ast.AST) -> InputError:
    return InputError(
        f"The expression may not {verb} {_shortened(ast.unparse(node))}: allowed are {ALLOWED}."
    )


def _shortened(text: str) -> str:
    return repr(text if len(text) <= 40 else text[:37] + "...")
