# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers as people read them: no powers of ten, no more digits than count."""

from decimal import Decimal

SMALLEST, SHORTEST_MS = 0.001, 0.1  # what is less is said to be less


def plain(value: float, digits: int = 3) -> str:
    """`12,300`, `0.25`, `< 0.001`: `digits` digits that count, and all that stand before the point."""
    if value != value or abs(value) == float("inf"):
        return str(value)
    if 0 < abs(value) < SMALLEST:
        return f"< {SMALLEST:g}"
    if abs(value) >= 10.0**digits:
        return f"{value:,.0f}"
    return f"{Decimal(f'{value:.{digits}g}').normalize():,f}"


def time_text(ms: float | None) -> str:
    """`35 ms`, `4.2 s`; `< 0.1 ms`, as a narrow column has no more room; `-` where it is not known."""
    if ms is None:
        return "-"
    if 0.0 < ms < SHORTEST_MS:
        return f"< {SHORTEST_MS:g} ms"
    return f"{plain(ms)} ms" if ms < 1000.0 else f"{plain(ms / 1000.0)} s"


def unit_text(unit: str) -> str:
    """A declaration's unit as panels show it: `m3/s` and `m^3/s` as `m³/s`."""
    for exponent, sign in (("2", "²"), ("3", "³")):
        unit = unit.replace(f"m^{exponent}", f"m{sign}").replace(f"m{exponent}", f"m{sign}")
    return unit


def number(value: float | None) -> str:
    """In a table: three digits that count, and none beyond the point from 100 on; nothing for what was not measured."""
    if value is None:
        return ""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def length_text(metres: float) -> str:
    """A length with the unit that suits it: `31.9 km`, `20 m`, `2.5 mm`."""
    for unit, size in (("km", 1000.0), ("m", 1.0)):
        if abs(metres) >= size:
            return f"{plain(metres / size)} {unit}"
    return f"{plain(metres)} m" if abs(metres) >= 0.1 or metres == 0 else f"{plain(metres * 1000.0)} mm"
