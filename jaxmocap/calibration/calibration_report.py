"""What a calibration comes to: a few lines to read, and the same as figures.

INPUTS: a Calibrated or a Placed. OUTPUTS: plain text; a dict for JSON.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxmocap.calibration.calibrate import Calibrated
from jaxmocap.calibration.extrinsics import position
from jaxmocap.calibration.place_camera import Placed

_PIXELS = ("fx", "fy", "cx", "cy")


def intrinsics_text(found: Calibrated) -> str:
    """Pictures with their errors, parameters with their deviations, remarks, files."""
    width, height = found.result.lens.size
    used = sum(found.result.used)
    total = len(found.found.pictures)
    lines = [
        f"[{found.camera}] {width:g} × {height:g} pixels, {used} of {total} pictures used, "
        f"{found.result.rms:.3f} pixels RMS",
        "",
        "picture: reprojection, tilt of the board",
        *(_picture(*row) for row in found.rows()),
        *(f"  {name}: no board found" for name in found.found.not_found),
        *(f"  {name}: the same as an earlier one" for name in found.found.repeated),
        "",
        *_parameters(found),
        "",
        f"coverage: {100 * found.coverage.share:.0f} % of the image",
        *(f"note: {sentence}" for sentence in found.remarks),
        *(f"written: {path}" for path in found.files),
    ]
    return "\n".join(lines)


def _picture(name: str, error: float, tilt: float, used: bool) -> str:
    if not used:
        return f"  {name}: {error:.2f} px, LEFT OUT: its corners do not fit the other views"
    return f"  {name}: {error:.2f} px, {tilt:.0f}°"


def _parameters(found: Calibrated) -> list[str]:
    result = found.result
    rows = [["", "value", "std", "one view left out", "jackknife std"]]
    ranges = np.stack([result.left_out.min(0), result.left_out.max(0)], -1)
    for name, value, std, (low, high), jackknife in zip(
        result.parameters, result.values, result.std, ranges, result.jackknife, strict=True
    ):
        if value == 0 and std == 0:
            continue
        digits = 1 if name in _PIXELS else 4
        cells = [f"{number:.{digits}f}" for number in (value, std, low, high, jackknife)]
        rows.append([name, cells[0], cells[1], f"{cells[2]} to {cells[3]}", cells[4]])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(c.rjust(w) for c, w in zip(row, widths, strict=True)) for row in rows]


def intrinsics_figures(found: Calibrated) -> dict[str, Any]:
    """The same as plain figures: pixels, degrees."""
    result = found.result
    parameters = {
        name: {
            "value": float(result.values[i]),
            "std": float(result.std[i]),
            "jackknife_std": float(result.jackknife[i]),
            "left_out_min": float(result.left_out[:, i].min()),
            "left_out_max": float(result.left_out[:, i].max()),
        }
        for i, name in enumerate(result.parameters)
    }
    pictures = [
        {"name": name, "rms_px": _finite(error), "tilt_deg": _finite(tilt), "used": use}
        for name, error, tilt, use in found.rows()
    ]
    return {
        "camera": found.camera,
        "size": [int(n) for n in result.lens.size],
        "board": found.found.board.label,
        "rms_px": result.rms,
        "pictures": pictures,
        "used": sum(result.used),
        "left_out": [name for name, _, _, use in found.rows() if not use],
        "not_found": list(found.found.not_found),
        "repeated": list(found.found.repeated),
        "parameters": parameters,
        "coverage": found.coverage.share,
        "empty": list(found.coverage.empty),
        "remarks": list(found.remarks),
        "files": [str(path) for path in found.files],
    }


def extrinsics_text(found: Placed) -> str:
    """The camera's place, how sure it is, remarks, files."""
    placement = found.placement
    x, y, z = placement.position_world
    lines = [
        f"[{found.camera}] stands at ({x:.3f}, {y:.3f}, {z:.3f}) m, looks along "
        f"{_vector(placement.T_cam_world[2, :3])}",
        f"  {found.image}: {placement.rms:.2f} pixels RMS over {placement.used.sum()} of "
        f"{len(found.names)} points",
        f"  standard deviation: {_vector(1e3 * placement.std_m, 1)} mm, {placement.std_deg:.2f}°, "
        "by the corners' noise alone (not the intrinsics', nor that of what was measured)",
    ]
    if placement.mirrored is not None:
        lines.append(
            f"  the mirrored answer that a flat target has, at "
            f"{_vector(position(placement.mirrored))} m, fits {placement.mirrored_times:.1f} times "
            "as badly"
        )
    lines += [f"note: {sentence}" for sentence in found.remarks]
    return "\n".join([*lines, *(f"written: {path}" for path in found.files)])


def extrinsics_figures(found: Placed) -> dict[str, Any]:
    """The same as plain figures: metres, degrees, pixels."""
    placement = found.placement
    mirrored = None if placement.mirrored is None else position(placement.mirrored).tolist()
    return {
        "camera": found.camera,
        "position": placement.position_world.tolist(),
        "looks_along": placement.T_cam_world[2, :3].tolist(),
        "rotation": placement.rotation.tolist(),
        "translation": placement.T_cam_world[:3, 3].tolist(),
        "rms_px": placement.rms,
        "position_std_m": placement.std_m.tolist(),
        "direction_std_deg": placement.std_deg,
        "points": [
            {"name": name, "off_px": float(np.linalg.norm(residual)), "used": bool(use)}
            for name, residual, use in zip(
                found.names, placement.residuals_xy, placement.used, strict=True
            )
        ],
        "mirrored_position": mirrored,
        "mirrored_times": _finite(placement.mirrored_times),
        "remarks": list(found.remarks),
        "files": [str(path) for path in found.files],
    }


def _vector(values: Sequence[float] | np.ndarray, digits: int = 2) -> str:
    return f"({', '.join(f'{value:.{digits}f}' for value in values)})"


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
