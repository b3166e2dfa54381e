"""Units as people and datasheets write them, to SI and back. No other module converts.

    si = value * scale + offset          (the offset is zero but for degC)

A unit is a product of names with powers, read from left to right: `m/s^2`, `deg/sqrt(h)`, `ug/Hz^0.5`, `kg*m^-3`,
`rad s^(-1/2)`, `m/s/sqrt(h)`, `1/s`. The powers may be written `^` or `**`, a product `*`, `·` or a space.

Three readings that differ between fields:
- `g` is standard gravity, 9.80665 m/s^2, and `mg` and `ug` are its parts, as datasheets of inertial sensors write them;
  masses are in `kg`.
- `rad` is a dimension of its own, so that a rate of turn (`rad/s`) is never taken for a frequency (`Hz`).
- `degC` alone is a temperature on the Celsius scale; inside a product (`mg/degC`) it is a difference, equal to `K`.

The names, and what they are worth, stand in recon.unit_table.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, overload

from recon.problems import did_you_mean
from recon.unit_table import BASE, CELSIUS_ZERO, NAMED_SI, QUANTITY_NAMES, UNITS, Dimension, Product

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]

MOST_CHARACTERS = 80
LARGEST_EXPONENT = 12
LARGEST_FACTOR = Fraction(10) ** 25
_SPOKEN = (("years", 31_557_600), ("days", 86400), ("h", 3600), ("min", 60))


class UnitError(ValueError):
    """A unit or quantity that cannot be read, or that measures something else. The message is one sentence."""


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit and how it relates to SI.

    text : as given; dimension : exponents of m, kg, s, A, K, rad; factor : SI units in one of this, exact but for pi
    and roots, which are rounded once; offset : SI value of its zero.
    """

    text: str
    dimension: Dimension
    factor: Fraction
    offset: float = 0.0

    @property
    def scale(self) -> float:
        """SI units in one of this unit."""
        return float(self.factor)


def parse_unit(text: str) -> Unit:
    """Read a unit.

    Raises UnitError for an unknown name, for text that is no unit, and for sizes that no real unit has.
    """
    plain = text.strip().translate(_PLAIN)
    if not plain:
        raise UnitError("the unit is empty; write '1' for a plain number")
    if len(plain) > MOST_CHARACTERS:
        raise UnitError(f"the unit '{plain[:20]}...' is longer than {MOST_CHARACTERS} characters")
    parser = _Parser(text, plain)
    factor, dimension = parser.whole()
    offset = CELSIUS_ZERO if plain.strip("( )") == "degC" else 0.0
    return Unit(text, dimension, factor, offset)


def parse_quantity(text: str, into: str) -> float:
    """The number that `text`, such as `0.24 deg/sqrt(h)`, is in the unit `into`.

    A plain number is accepted where `into` is `1`, and only there. Raises UnitError for text that is not a finite
    decimal number with a unit, and for a unit of another dimension than `into`.
    """
    text = text.strip()
    found = _QUANTITY.fullmatch(text)
    if found is None:
        raise UnitError(f"'{text:.40}' is not a number with a unit; write for example '{_joined('12', into)}'")
    number, unit_text = found["number"], found["unit"]
    target = parse_unit(into)
    if not unit_text and (any(target.dimension) or target.factor != 1):
        raise UnitError(f"a unit is missing: write for example '{number} {into}'")
    unit = parse_unit(unit_text or "1")
    if unit.dimension != target.dimension:
        wanted = f"a unit like {into}" if any(target.dimension) else "a plain number"
        raise UnitError(f"'{text}' is {_described(unit)}; needs {wanted}")
    value = _converted(float(number), unit, target)
    if not math.isfinite(value):
        raise UnitError(f"'{text}' is too large for a number")
    return value


@overload
def convert(value: float, from_unit: str, to_unit: str) -> float: ...
@overload
def convert(value: FloatArray, from_unit: str, to_unit: str) -> FloatArray: ...
def convert(value: float | FloatArray, from_unit: str, to_unit: str) -> float | FloatArray:
    """`value`, a number or an array of any shape, from one unit into another; the argument is left as it is.

    A number and an array's element convert to the same bits. Raises UnitError where the dimensions differ.
    """
    source, target = parse_unit(from_unit), parse_unit(to_unit)
    if source.dimension != target.dimension:
        raise UnitError(f"cannot convert: one unit is {_described(source)}, the other {_described(target)}")
    return _converted(value, source, target)


def si_unit(text: str) -> str:
    """The SI unit of what `text` measures, in its one canonical form: `m/s^2`, `rad/s^0.5`, `Hz`, `T`, `Pa`, `1`."""
    return _si_text(parse_unit(text).dimension)


def format_quantity(value_si: float, unit: str) -> str:
    """Text of an SI value that `parse_quantity` reads back to the same bits.

    It is in `unit`, with as few digits as that takes, or in SI where no decimal number of 17 digits in `unit` gives
    exactly this value. Raises UnitError for a value that is not finite.
    """
    value = float(value_si)
    if not math.isfinite(value):
        raise UnitError(f"{value} cannot be written as a quantity")
    shown = parse_unit(unit)
    si = _si_text(shown.dimension)
    in_unit = _converted(value, parse_unit(si), shown)
    for digits in (15, 16, 17):
        number = f"{in_unit:.{digits}g}"
        if _converted(float(number), shown, parse_unit(si)) == value:
            return _joined(number, unit)
    return _joined(repr(value), si)


def duration_text(seconds: float) -> str:
    """A duration as people say it: `2.4 s`, `12 min`, `7.5 h`, `3 days`, `17 years`."""
    for unit, size in _SPOKEN:
        if seconds >= 2 * size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds:.3g} s"


def _joined(number: str, unit: str) -> str:
    return number if unit == "1" else f"{number} {unit}"


@overload
def _converted(value: float, source: Unit, target: Unit) -> float: ...
@overload
def _converted(value: FloatArray, source: Unit, target: Unit) -> FloatArray: ...
def _converted(value: float | FloatArray, source: Unit, target: Unit) -> float | FloatArray:
    """Multiply by a ratio above one and divide by the inverse of one below.

    The ratios of decimal units are whole numbers in one of the two directions, so that `30 ms` is the double 0.03.
    """
    ratio = source.factor / target.factor
    scaled = value * float(ratio) if ratio >= 1 else value / float(1 / ratio)
    shift = (source.offset - target.offset) / target.scale
    return scaled + shift if shift else scaled


# --- the text of dimensions -----------------------------------------------------------------------------------------


def _si_text(dimension: Dimension) -> str:
    if dimension in NAMED_SI:
        return NAMED_SI[dimension]
    above = [_power_text(name, power) for name, power in zip(BASE, dimension, strict=True) if power > 0]
    below = [_power_text(name, -power) for name, power in zip(BASE, dimension, strict=True) if power < 0]
    numerator = "*".join(above) or "1"
    if not below:
        return numerator
    return f"{numerator}/{below[0]}" if len(below) == 1 else f"{numerator}/({'*'.join(below)})"


def _power_text(name: str, power: Fraction) -> str:
    if power == 1:
        return name
    is_decimal = Fraction(f"{float(power):g}") == power
    return f"{name}^{float(power):g}" if is_decimal else f"{name}^({power})"


def _described(unit: Unit) -> str:
    si = _si_text(unit.dimension)
    if si == "1":
        return "a plain number"
    return f"{QUANTITY_NAMES[si]} ({unit.text})" if si in QUANTITY_NAMES else f"in {unit.text}"


# --- reading --------------------------------------------------------------------------------------------------------

_PLAIN = str.maketrans({"µ": "u", "μ": "u", "·": "*", "⋅": "*", "°": "deg", "²": "^2", "³": "^3"})
_QUANTITY = re.compile(
    r"(?P<number>[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)(?:\s+|(?=[^0-9_.,]|$))(?P<unit>.*)"
)
_TOKEN = re.compile(
    r"""\s*(?: (?P<name> [A-Za-z]+ | % | 1(?![0-9.]) )
             | (?: \^ | \*\* ) \s* (?: (?P<power> [+-]?[0-9]+(?:\.[0-9]+)? )
                                     | \( \s* (?P<bracketed> [+-]?[0-9]+ (?: \.[0-9]+ | \s*/\s*[0-9]+ )? ) \s* \) )
             | (?P<sign> [*/()] ) )""",
    re.VERBOSE,
)


class _Parser:
    """One pass over the tokens of a unit, by recursive descent.

    product = power { ["*" | "/"] power };  power = atom { exponent };  atom = name | "1" | ["sqrt"] "(" product ")"
    """

    def __init__(self, text: str, plain: str) -> None:
        self.text = text
        self.plain = plain
        self.position = 0

    def whole(self) -> Product:
        product = self._product()
        if self.position < len(self.plain):
            raise self._unreadable()
        return product

    def _product(self) -> Product:
        product = self._power()
        while (token := self._peek()) is not None and (token["name"] or token["sign"] in ("*", "/", "(")):
            if token["sign"] in ("*", "/"):
                self.position = token.end()
            exponent = Fraction(-1 if token["sign"] == "/" else 1)
            product = self._times(product, self._raised(self._power(), exponent))
        return product

    def _power(self) -> Product:
        product = self._atom()
        while (token := self._peek()) is not None and (written := token["power"] or token["bracketed"]):
            self.position = token.end()
            try:
                exponent = Fraction(re.sub(r"\s", "", written))
            except ZeroDivisionError:
                raise UnitError(f"the unit '{self.text}' has an exponent that divides by zero") from None
            product = self._raised(product, exponent)
        return product

    def _atom(self) -> Product:
        token = self._peek()
        if token is None or not (token["name"] or token["sign"] == "("):
            raise self._unreadable()
        self.position = token.end()
        if token["sign"] == "(":
            product = self._product()
            self._close()
            return product
        if token["name"] == "sqrt" and (bracket := self._peek()) is not None and bracket["sign"] == "(":
            return self._raised(self._atom(), Fraction(1, 2))
        if token["name"] not in UNITS:
            raise self._unknown(token["name"])
        return UNITS[token["name"]]

    def _close(self) -> None:
        token = self._peek()
        if token is None or token["sign"] != ")":
            raise UnitError(f"the unit '{self.text}' has a bracket that is not closed")
        self.position = token.end()

    def _peek(self) -> re.Match[str] | None:
        return _TOKEN.match(self.plain, self.position)

    def _times(self, one: Product, other: Product) -> Product:
        dimension = tuple(a + b for a, b in zip(one[1], other[1], strict=True))
        return self._bounded(one[0] * other[0], dimension)

    def _raised(self, product: Product, exponent: Fraction) -> Product:
        if abs(exponent) > LARGEST_EXPONENT:
            raise UnitError(f"the unit '{self.text}' has an exponent above {LARGEST_EXPONENT}")
        factor, dimension = product
        whole = exponent.denominator == 1
        power = factor**exponent.numerator if whole else Fraction(float(factor) ** float(exponent))
        return self._bounded(power, tuple(part * exponent for part in dimension))

    def _bounded(self, factor: Fraction, dimension: Dimension) -> Product:
        if not 1 / LARGEST_FACTOR <= factor <= LARGEST_FACTOR:
            raise UnitError(f"the unit '{self.text}' is out of any useful size")
        return factor, dimension

    def _unreadable(self) -> UnitError:
        rest = self.plain[self.position :].strip()
        if not rest:
            return UnitError(f"the unit '{self.text}' ends too early")
        hint = "; write a power as m^2" if self.position and rest[0] in "+-0123456789" else ""
        return UnitError(f"the unit '{self.text}' cannot be read at '{rest}'{hint}")

    def _unknown(self, name: str) -> UnitError:
        suggestion = did_you_mean(name, UNITS)
        place = "" if name == self.plain else f" in '{self.text}'"
        return UnitError(f"unknown unit '{name}'{place}" + (f"; {suggestion}" if suggestion else ""))
