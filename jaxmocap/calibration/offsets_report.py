"""What the calibration of devices found, for people and for programs.

INPUTS: Held devices. OUTPUTS: text with lines for [markers.on]; figures for JSON.
"""

from collections.abc import Sequence

from jaxmocap.body.orientations import quaternions
from jaxmocap.calibration.offsets import DeviceOffset


def offsets_text(found: Sequence[DeviceOffset]) -> str:
    """What was found, and lines for [markers.on]."""
    lines = []
    for held in found:
        mm, std = 1e3 * held.offset, 1e3 * held.std
        told = ", ".join(f"{a:.1f} ± {b:.1f}" for a, b in zip(mm, std, strict=True))
        lines.append(
            f"{held.place.name}: {told} mm from the joint of {held.place.bone}, which strayed by "
            f"{1e3 * held.joint_rms:.1f} mm a second while it turned by {held.rotation_rms:.0f}°"
        )
        if held.orientation is not None:
            lines.append(f"  held within {held.orientation_rms:.1f}° while standing (how straight the "
                         "person stood is not in that)")  # fmt: skip
        lines += [f"  doubtful: {doubt}" for doubt in held.warnings]
    lines += ["", "[markers.on]", *(toml_line(held) for held in found if not held.warnings)]
    return "\n".join(lines)


def toml_line(held: DeviceOffset) -> str:
    """The entry of [markers.on]."""
    x, y, z = held.offset
    entry = f'bone = "{held.place.bone}", at = 0.0, offset = [{x:.4f}, {y:.4f}, {z:.4f}]'
    if held.orientation is not None:
        turn = ", ".join(f"{part:.4f}" for part in quaternions(held.orientation))
        return f'{held.place.name} = {{ {entry}, offset_in = "marker", turn = [{turn}] }}'
    return f'{held.place.name} = {{ {entry}, offset_in = "marker" }}'


def offsets_figures(offsets: Sequence[DeviceOffset]) -> dict:
    """The same as figures."""
    return {
        held.place.name: {
            "bone": held.place.bone,
            "offset_m": held.offset.tolist(),
            "std_m": held.std.tolist(),
            "covariance_m2": held.covariance.tolist(),
            "stray_m": held.joint_rms,
            "swing_deg": held.rotation_rms,
            "seconds": held.windows,
            "turn_wxyz": None
            if held.orientation is None
            else quaternions(held.orientation).tolist(),
            "turn_spread_deg": None if held.orientation is None else held.orientation_rms,
            "doubts": list(held.warnings),
        }
        for held in offsets
    }
