"""What the calibration of devices found, for people and for programs.

INPUTS: DeviceOffsets. OUTPUTS: text with lines for [markers.on]; figures for JSON.
"""

from collections.abc import Sequence

from jaxmocap.body.orientations import quaternions
from jaxmocap.calibration.devices.offsets import DeviceOffset


def offsets_text(offsets: Sequence[DeviceOffset]) -> str:
    """What was found, and lines for [markers.on]."""
    lines = []
    for offset in offsets:
        mm, std = 1e3 * offset.offset, 1e3 * offset.std
        values = ", ".join(f"{a:.1f} ± {b:.1f}" for a, b in zip(mm, std, strict=True))
        lines.append(
            f"{offset.place.name}: {values} mm from the joint of {offset.place.bone}, which "
            f"moved by {1e3 * offset.joint_rms:.1f} mm a second while it rotated by "
            f"{offset.rotation_rms:.0f}°"
        )
        if offset.orientation is not None:
            lines.append(
                f"  orientation within {offset.orientation_rms:.1f}° while standing (how "
                "straight the person stood is not in that)"
            )
        lines += [f"  warning: {warning}" for warning in offset.warnings]
    lines += ["", "[markers.on]", *(toml_line(offset) for offset in offsets if not offset.warnings)]
    return "\n".join(lines)


def toml_line(offset: DeviceOffset) -> str:
    """The entry of [markers.on]."""
    x, y, z = offset.offset
    entry = f'bone = "{offset.place.bone}", at = 0.0, offset = [{x:.4f}, {y:.4f}, {z:.4f}]'
    if offset.orientation is not None:
        quaternion = ", ".join(f"{part:.4f}" for part in quaternions(offset.orientation))
        return f'{offset.place.name} = {{ {entry}, offset_in = "marker", turn = [{quaternion}] }}'
    return f'{offset.place.name} = {{ {entry}, offset_in = "marker" }}'


def offsets_figures(offsets: Sequence[DeviceOffset]) -> dict:
    """The same as figures."""
    return {
        offset.place.name: {
            "bone": offset.place.bone,
            "offset_m": offset.offset.tolist(),
            "std_m": offset.std.tolist(),
            "covariance_m2": offset.covariance.tolist(),
            "joint_rms_m": offset.joint_rms,
            "rotation_rms_deg": offset.rotation_rms,
            "seconds": offset.windows,
            "turn_wxyz": None
            if offset.orientation is None
            else quaternions(offset.orientation).tolist(),
            "turn_rms_deg": None if offset.orientation is None else offset.orientation_rms,
            "warnings": list(offset.warnings),
        }
        for offset in offsets
    }
