"""How likely colours are before a learned background, lit or in shadow: on the host and the device.

INPUTS: scalar products of colours with the background's. OUTPUTS: densities.
"""

from collections.abc import Callable
from typing import Any

# Share of the background that lies in shadow, and how much light is left there at least.
SHADED, DARKEST = 0.05, 0.6
# Beyond this exponent a normal density is none at all (and would underflow).
FARTHEST = 60.0


def lit_or_shaded_density(
    observed_observed: Any,
    observed_room: Any,
    room_room: Any,
    noise: Any,
    exp: Callable[[Any], Any],
) -> Any:
    """Density (...), per cubic grey level, of colours before a background, lit or shaded.

    Normal about the background's colour; or, in shadow, evenly on the way from there towards black
    as far as ``DARKEST``, and normal across it.

    Args:
        observed_observed: (...) NumPy's or JAX's: squares of the colours,
        observed_room: products with those of the background,
        room_room: and squares of these, grey levels.
        noise: (...) standard deviation of each channel of the background, grey levels.
        exp: that is fastest for such arrays.
    """
    xp, room_room = room_room.__array_namespace__(), room_room + 1
    lit = xp.clip(observed_room / room_room, DARKEST, 1)
    across = observed_observed - lit * (2 * observed_room - lit * room_room)
    away = observed_observed - 2 * observed_room + room_room
    precision = 0.5 / noise**2
    planar = precision / xp.pi
    plain = planar * xp.sqrt(planar) * exp(-xp.minimum(away * precision, FARTHEST))
    length = (1 - DARKEST) * xp.sqrt(room_room)
    shaded = planar / length * exp(-xp.minimum(across * precision, FARTHEST))
    return (1 - SHADED) * plain + SHADED * shaded
