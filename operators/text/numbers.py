# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers for readers: no powers of ten, and only significant digits."""

from decimal import Decimal

SMALLEST, SHORTEST_MS = 0.001, 0.1  # smaller values are shown as `< 0.001` and `< 0.1 ms`


def plain(value: float, digits: int = 3) -> str:
    """Format as `12,300`, `0.25` or `< 0.001`, with `digits` significant digits and all digits before the point.

    A number closer to 0 than SMALLEST is shown by that limit, without its sign; inf and nan by their names.
    """
    if value != value or abs(value) == float("inf"):
        return str(value)
    if 0 < abs(value) < SMALLEST:
        return f"< {SMALLEST:g}"
    if abs(value) >= 10.0**digits:
        return f"{value:,.0f}"
    return f"{Decimal(f'{value:.{digits}g}').normalize():,f}"


def time_text(ms: float | None) -> str:
    """Format a duration for a narrow column as `35 ms`, `4.2 s`, `< 0.1 ms`, or `-` if unknown."""
    if ms is None:
        return "-"
    if 0.0 < ms < SHORTEST_MS:
        return f"< {SHORTEST_MS:g} ms"
    return f"{plain(ms)} ms" if ms < 999.5 else f"{plain(ms / 1000.0)} s"


def unit_text(unit: str) -> str:
    """Format a declared unit for panels: `m3/s` and `m^3/s` become `m³/s`."""
    for exponent, sign in (("2", "²"), ("3", "³")):
        unit = unit.replace(f"m^{exponent}", f"m{sign}").replace(f"m{exponent}", f"m{sign}")
    return unit


def number(value: float | None) -> str:
    """Format for a table as `plain` does, and None as ""."""
    return "" if value is None else plain(value)


def length_text(metres: float) -> str:
    """Format a length with a suitable unit: `31.9 km`, `20 m`, `2.5 mm`."""
    for unit, size in (("km", 1000.0), ("m", 1.0)):
        if abs(metres) >= size:
            return f"{plain(metres / size)} {unit}"
    return f"{plain(metres)} m" if abs(metres) >= 0.1 or metres == 0 else f"{plain(metres * 1000.0)} mm"
