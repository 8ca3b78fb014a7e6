"""Numbers as a reader wants them: as many digits as the standard error supports."""

from math import isfinite

from labkit.uncertain import decimals

MINUS = "\N{MINUS SIGN}"
UNKNOWN = "\N{EM DASH}"


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
    return f"{fixed(value, places)} ± {fixed(std, places)}"


def millimetres(range_mm: float | None) -> str:
    """A range with its unit, or that there is none."""
    return "no range" if range_mm is None else f"{range_mm:g} mm"
