"""Numbers as a reader wants them: as many digits as the standard error supports."""

from math import isfinite

from labkit.uncertain import Uncertain, decimals

MINUS = "\N{MINUS SIGN}"
UNKNOWN = "\N{EM DASH}"
PLUS_MINUS = "\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}"  # never parted from its numbers at the end of a line


def fixed(value: float | None, places: int) -> str:
    """A number to so many decimal places; a dash where there is none."""
    if value is None or not isfinite(value):
        return UNKNOWN
    text = f"{value:.{places}f}"
    return (text if float(text) else text.lstrip("-")).replace("-", MINUS)


def plus_minus(value: float, std: float, places: int | None = None) -> str:
    """A number and its standard error to the same decimal place; the number alone where there is no error."""
    if not isfinite(std):
        return fixed(value, 4 if places is None else places)
    places = decimals(std) if places is None else places
    return f"{fixed(value, places)}{PLUS_MINUS}{fixed(std, places)}"


def estimated(number: Uncertain | None, factor: float = 1.0, *, least: int = 0) -> str:
    """An estimate times a factor, to the decimal places of its error but no fewer than least; a dash where there is none."""
    if number is None:
        return UNKNOWN
    value, std = number.value * factor, number.std * factor
    known = isfinite(std) and std > 0
    return plus_minus(value, std, max(least, decimals(std)) if known else max(least, 1 if abs(value) >= 10 else 3))


def millimetres(range_mm: float | None) -> str:
    """A range with its unit, or that there is none."""
    return "no range" if range_mm is None else f"{range_mm:g} mm"
