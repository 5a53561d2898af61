"""Units of force, angle, moment, time, length, pressure and speed, as in headers of tables; g."""

from __future__ import annotations

import re
from math import pi

GRAVITY = 9.81
"""Acceleration of gravity g [m/s²]."""
FORCE = {
    "N": 1.0, "kN": 1e3, "mN": 1e-3, "MN": 1e6, "lbf": 4.4482216152605, "ozf": 0.27801385095378125,
    "kgf": 9.80665, "gf": 9.80665e-3, "dyn": 1e-5,
}  # fmt: skip
"""Newtons."""
ANGLE = {"deg": 1.0, "rad": 180.0 / pi, "mrad": 0.18 / pi, "rev": 360.0, "gon": 0.9}
"""Degrees."""
MOMENT = {"N m": 1.0, "kN m": 1e3, "kN mm": 1.0, "mN m": 1e-3, "N mm": 1e-3, "N cm": 1e-2}
MOMENT |= {"kgf cm": 0.0980665, "kgf m": 9.80665}
MOMENT |= {"lbf ft": 1.3558179483314, "lbf in": 0.1129848290276167, "ozf in": 7.061551814e-3}
"""Newton meters."""
TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
"""Seconds."""
LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254, "ft": 0.3048}
"""Meters."""
PRESSURE = {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "bar": 1e5, "psi": 6894.757293168}
"""Pascals."""
SHARE = {"part": 1.0, "%": 0.01}
"""A part of one."""
SPEED = {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "m/min": 1.0 / 60.0, "km/h": 1.0 / 3.6}
"""Meters per second."""
RATE = {"rad/s": 1.0, "deg/s": pi / 180.0, "rpm": pi / 30.0}
"""Radians per second."""
KINDS = {"force": FORCE, "angle": ANGLE, "moment": MOMENT, "time": TIME, "length": LENGTH}
KINDS |= {"way": LENGTH, "pressure": PRESSURE, "share": SHARE, "speed": SPEED, "rate": RATE}
_OTHER_NAMES = {
    "newton": "N", "newtons": "N", "lb": "lbf", "lbs": "lbf", "pound": "lbf", "pounds": "lbf",
    "kp": "kgf", "kg": "kgf", "g": "gf", "°": "deg", "º": "deg", "degree": "deg", "degrees": "deg",
    "grad": "deg", "radian": "rad", "radians": "rad", "turn": "rev", "turns": "rev",
    "u": "rev", "sec": "s", "secs": "s", "second": "s", "seconds": "s", "sek": "s", "msec": "ms",
    "µs": "us", "μs": "us", "ft lb": "lbf ft", "ft lbf": "lbf ft", "in lb": "lbf in",
    "in lbf": "lbf in", "oz": "ozf", "lb in": "lbf in", "lb ft": "lbf ft", "kg cm": "kgf cm",
    "kg m": "kgf m", "percent": "%", "u/min": "rpm", "1/min": "rpm", "r/min": "rpm", "m s-1": "m/s",
    "°/s": "deg/s",
}  # fmt: skip
"""Other names, in lower case. *Grad* is German for degree; a grade is ``gon``."""
_EXACT = {name.replace(" ", ""): name for units in KINDS.values() for name in units}
_LOWER = {compact.lower(): name for compact, name in _EXACT.items() if name != "MN"}
_LOWER |= {name.replace(" ", ""): unit for name, unit in _OTHER_NAMES.items()}


def unit_named(text: str) -> str | None:
    """Our name of a unit, however it is written, such as ``lbf`` for ``Lbs``; or ``None``."""
    compact = re.sub(r"[\s·*]", "", text.strip(" []()<>{}."))
    return _EXACT.get(compact) or _LOWER.get(compact.lower())
