"""A number with its standard error, printed to as many digits as the error supports."""

from __future__ import annotations

import html
import math
from dataclasses import dataclass

LARGE, SMALL = 1e7, 1e-4  # from here on, and below, a power of ten is taken out
DIGITS_WITHOUT_ERROR = 6  # of a number that has no error to say how many
SIGN_OPEN = "sign open"


def decimals(std: float, most: int = DIGITS_WITHOUT_ERROR) -> int:
    """Return the decimal places that give a standard error two significant digits; 4 without an error."""
    if not (math.isfinite(std) and std > 0):
        return 4
    rounded = float(f"{std:.1e}")  # 0.0996 becomes 0.10
    return min(max(0, 1 - math.floor(math.log10(rounded))), most)


@dataclass(frozen=True, slots=True)
class Uncertain:
    """A value and its standard error.

    Parameters
    ----------
    value : the estimate
    std : standard error; nan if unknown, infinite if the data do not determine the value
    unit : printed after both, such as "mm"
    sign_open : whether the negative of the value is as likely, as of an even Zernike mode
        of one range; printed without a sign then

    Raises
    ------
    ValueError
        for a negative standard error

    >>> print(Uncertain(3024.0, 0.4, "mm"))
    3024.00 ± 0.40 mm
    >>> print(Uncertain(-0.579, 0.003, "waves", sign_open=True))
    ±0.5790 ± 0.0030 waves, sign open
    """

    value: float
    std: float = math.nan
    unit: str = ""
    sign_open: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "value", float(self.value))
        object.__setattr__(self, "std", float(self.std))
        if self.std < 0:
            raise ValueError(f"std = {self.std:g}: a standard error is 0 or more")

    def __str__(self) -> str:
        number, exponent = self._number()
        return self._with_unit(f"({number})e{exponent:+03d}" if exponent else number)

    def __format__(self, spec: str) -> str:
        """Return both numbers in a number's format (".2f", "+.3g"), or the text of `str` in a text's (">24")."""
        if spec[-1:] not in tuple("eEfFgG"):
            return format(str(self), spec)
        plain = spec.lstrip("+ ")
        value = f"±{abs(self.value):{plain}}" if self.sign_open else f"{self.value:{spec}}"
        return self._with_unit(f"{value} ± {_error(self.std, plain)}")

    def _repr_html_(self) -> str:
        number, exponent = self._number()
        power = f"({number}) × 10<sup>{exponent}</sup>" if exponent else number
        return (
            power.replace("-", "\N{MINUS SIGN}")
            + (f" {html.escape(self.unit)}" if self.unit else "")
            + self._note()
        )

    def as_json(self) -> dict[str, float | None]:
        """Return {"value": ..., "std": ...} with null for numbers that are not finite, which JSON lacks."""
        return {
            name: x if math.isfinite(x) else None
            for name, x in (("value", self.value), ("std", self.std))
        }

    def _with_unit(self, number: str) -> str:
        return (f"{number} {self.unit}" if self.unit else number) + self._note()

    def _note(self) -> str:
        return f", {SIGN_OPEN}" if self.sign_open else ""

    def _number(self) -> tuple[str, int]:
        """Return the text of value and error, and the power of ten taken out of both."""
        if not math.isfinite(self.value):
            return "not determined" if math.isnan(self.value) else f"{self.value:g}", 0
        known = math.isfinite(self.std) and self.std > 0
        largest = max(abs(self.value), self.std) if known else abs(self.value)
        exponent = (
            0
            if SMALL <= largest < LARGE or largest == 0
            else math.floor(math.log10(largest))
        )
        value = self.value / 10.0**exponent
        std = self.std / 10.0**exponent
        sign = "±" if self.sign_open else ""
        value = abs(value) if self.sign_open else value
        if not known:
            return f"{sign}{value:.{DIGITS_WITHOUT_ERROR}g} ± {_error(std, 'g')}", exponent
        places = decimals(std, most=15)
        rounded = round(value, places) + 0.0  # no minus zero
        return f"{sign}{rounded:.{places}f} ± {std:.{places}f}", exponent


def _error(std: float, spec: str) -> str:
    return "unknown" if math.isnan(std) else format(std, spec)
