"""What a calibration comes to: a few lines to read, and the same as figures.

INPUTS: an IntrinsicsResult or an ExtrinsicsResult. OUTPUTS: plain text; a dict for JSON.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxmocap.calibration.calibrate import IntrinsicsResult
from jaxmocap.calibration.extrinsics import position_world_of
from jaxmocap.calibration.intrinsics import IntrinsicsEstimate
from jaxmocap.calibration.place_camera import ExtrinsicsResult

_PIXELS = ("fx", "fy", "cx", "cy")


def intrinsics_text(result: IntrinsicsResult) -> str:
    """Pictures with their errors, parameters with their deviations, warnings, files."""
    width, height = result.estimate.lens.size
    pictures = [
        f"  {name}: {error:.2f} px, {tilt:.0f}°"
        if use
        else f"  {name}: {error:.2f} px, LEFT OUT: its corners do not fit the other views"
        for name, error, tilt, use in result.rows()
    ]
    used = sum(result.estimate.used)
    total = len(result.detections.pictures)
    lines = [
        f"[{result.camera}] {width:g} × {height:g} pixels, {used} of {total} pictures used, "
        f"{result.estimate.rms:.3f} pixels RMS",
        "",
        "picture: reprojection, tilt of the board",
        *pictures,
        *(f"  {name}: no board found" for name in result.detections.not_found),
        *(f"  {name}: the same as an earlier one" for name in result.detections.duplicates),
        "",
        *_parameters(result.estimate),
        "",
        f"coverage: {100 * result.coverage.share:.0f} % of the image",
        *(f"warning: {sentence}" for sentence in result.warnings),
        *(f"written  {path}" for path in result.files),
    ]
    return "\n".join(lines)


def _parameters(estimate: IntrinsicsEstimate) -> list[str]:
    rows = [["", "value", "std", "one view left out", "jackknife std"]]
    ranges = np.stack([estimate.leave_one_out.min(0), estimate.leave_one_out.max(0)], -1)
    columns = estimate.parameters, estimate.values, estimate.std, ranges, estimate.jackknife_std
    for name, value, std, (low, high), jackknife in zip(*columns, strict=True):
        if value == 0 and std == 0:
            continue
        digits = 1 if name in _PIXELS else 4
        cells = [f"{number:.{digits}f}" for number in (value, std, low, high, jackknife)]
        rows.append([name, cells[0], cells[1], f"{cells[2]} to {cells[3]}", cells[4]])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(c.rjust(w) for c, w in zip(row, widths, strict=True)) for row in rows]


def intrinsics_figures(result: IntrinsicsResult) -> dict[str, Any]:
    """The same as figures, pixels, degrees; what is not finite has none."""
    estimate = result.estimate
    parameters = {
        name: {
            "value": estimate.values[i],
            "std": estimate.std[i],
            "jackknife_std": estimate.jackknife_std[i],
            "left_out_min": estimate.leave_one_out[:, i].min(),
            "left_out_max": estimate.leave_one_out[:, i].max(),
        }
        for i, name in enumerate(estimate.parameters)
    }
    pictures = [
        {"name": name, "rms_px": error, "tilt_deg": tilt, "used": use}
        for name, error, tilt, use in result.rows()
    ]
    return {
        "camera": result.camera,
        "size_px": [int(n) for n in estimate.lens.size],
        "board": result.detections.board.label,
        "rms_px": estimate.rms,
        "pictures": pictures,
        "used": sum(estimate.used),
        "left_out": [name for name, _, _, use in result.rows() if not use],
        "not_found": result.detections.not_found,
        "repeated": result.detections.duplicates,
        "parameters": parameters,
        "coverage_share": result.coverage.share,
        "empty": result.coverage.empty,
        "warnings": result.warnings,
        "files": result.files,
    }


def extrinsics_text(result: ExtrinsicsResult) -> str:
    """The camera's place and its standard deviation, warnings, files."""
    placement = result.placement
    x, y, z = placement.position_world
    lines = [
        f"[{result.camera}] stands at ({x:.3f}, {y:.3f}, {z:.3f}) m, looks along "
        f"{_vector(placement.T_cam_world[2, :3])}",
        f"  {result.image}: {placement.rms:.2f} pixels RMS over {placement.used.sum()} of "
        f"{len(result.names)} points",
        f"  standard deviation: {_vector(1e3 * placement.std_m, 1)} mm, {placement.std_deg:.2f}°, "
        "by the corners' noise alone (not the intrinsics', nor that of what was measured)",
    ]
    if placement.mirrored is not None:
        lines.append(
            f"  the mirrored solution that a flat target has, at "
            f"{_vector(position_world_of(placement.mirrored))} m, fits "
            f"{placement.mirrored_ratio:.1f} times as badly"
        )
    lines += [f"warning: {sentence}" for sentence in result.warnings]
    return "\n".join([*lines, *(f"written  {path}" for path in result.files)])


def extrinsics_figures(result: ExtrinsicsResult) -> dict[str, Any]:
    """The same as figures, metres, degrees, pixels; what is not finite has none."""
    placement, mirrored = result.placement, result.placement.mirrored
    return {
        "camera": result.camera,
        "position_m": placement.position_world,
        "looks_along": placement.T_cam_world[2, :3],
        "rotation": placement.rotation,
        "translation_m": placement.T_cam_world[:3, 3],
        "rms_px": placement.rms,
        "position_std_m": placement.std_m,
        "direction_std_deg": placement.std_deg,
        "points": [
            {"name": name, "error_px": np.linalg.norm(residual), "used": use}
            for name, residual, use in zip(
                result.names, placement.residuals_xy, placement.used, strict=True
            )
        ],
        "mirrored_position_m": None if mirrored is None else position_world_of(mirrored),
        "mirrored_ratio": placement.mirrored_ratio,
        "warnings": result.warnings,
        "files": result.files,
    }


def _vector(values: Sequence[float] | np.ndarray, digits: int = 2) -> str:
    return f"({', '.join(f'{value:.{digits}f}' for value in values)})"
