"""A plan's results as text and figures.

INPUTS: places and deviations. OUTPUTS: lines; a dictionary for JSON.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxmocap.calibration.fitting.camera_plan.placement import BestPlace, Bounds, CameraPlace, Ring


class CameraPlan(NamedTuple):
    """Places of cameras and what they are worth; deviations of the joints in the mean, metres."""

    joints: tuple[str, ...]  # as they were asked for
    markers_alone: float  # without any camera
    present: float | None  # with the cameras of the recording; None without any
    best: tuple[BestPlace, ...]  # places one after the other, each with those before it
    fields_of_view: tuple[float, ...]  # of the cameras placed, degrees along the longer side
    fields_across: tuple[float, ...]  # of the same from left to right, degrees
    with_trackers: dict[str, float]  # tracker -> with the first camera and this tracker
    ring: Ring  # places about the person, before any was improved
    bounds: Bounds  # walls and heights

    def rows(self) -> list[tuple[str, float]]:
        """What there could be, and the joints' deviation, metres."""
        rows = [("markers alone", self.markers_alone)]
        if self.present is not None:
            rows.append(("as it stands now", self.present))
        names = ["one camera", *(f"{n} cameras" for n in range(2, len(self.best) + 1))]
        rows += [(name, each.error) for name, each in zip(names, self.best, strict=True)]
        return rows + [
            (f"one camera and {name}", error) for name, error in self.with_trackers.items()
        ]

    def text(self, files: Sequence[object] = ()) -> str:
        """The same as lines."""
        what = ", ".join(self.joints)
        lines = []
        for number, (each, fov) in enumerate(zip(self.best, self.fields_of_view, strict=True), 1):
            lines.append((f"camera {number}", f"{in_words(each.place)}; lens {fov:.0f}°"))
        lines += [(name, f"{what} ± {100 * error:.1f} cm") for name, error in self.rows()]
        lines += [("written", str(path)) for path in files]
        width = max(len(name) for name, _ in lines)
        return "\n".join(f"{name.ljust(width)}  {text}" for name, text in lines)

    def figures(self) -> dict:
        """The same for JSON, with the derivatives at each place."""
        ring = np.array(self.ring.places)[:3].T.round(3).tolist()
        finite = [None if not np.isfinite(e) else round(float(e), 5) for e in self.ring.errors]
        return {
            "joints": list(self.joints),
            "expected_m": {name: round(error, 5) for name, error in self.rows()},
            "cameras": [
                {
                    "ahead_m": round(float(place.ahead), 3),
                    "left_m": round(float(place.left), 3),
                    "height_m": round(float(place.height), 3),
                    "yaw_deg": round(_within_half_turn(float(np.degrees(place.yaw))), 2),
                    "pitch_deg": round(float(np.degrees(place.pitch)), 2),
                    "fov_deg": round(fov, 2),
                    "expected_m": round(error, 5),
                    "slope": {
                        name: round(float(value), 5)
                        for name, value in zip(CameraPlace._fields, slope, strict=True)
                    },
                }
                for (place, error, slope), fov in zip(self.best, self.fields_of_view, strict=True)
            ],
            "ring": [
                {"ahead_m": a, "left_m": b, "height_m": c, "expected_m": error}
                for (a, b, c), error in zip(ring, finite, strict=True)
            ],
        }


def in_words(place: CameraPlace) -> str:
    """Where a camera stands, about the person, and how it looks."""
    azimuth, pitch = place.azimuth_deg, float(np.degrees(place.pitch))
    around = f"{abs(azimuth):.0f}° to the {'left' if azimuth > 0 else 'right'}"
    if abs(azimuth) < 3:
        around = "straight ahead"
    elif abs(azimuth) > 177:
        around = "straight behind"
    level = f"{abs(pitch):.0f}° {'down' if pitch < 0 else 'up'}" if abs(pitch) >= 1 else "level"
    # How far the camera is turned to its left of the person, who is then right in its image.
    aside = _within_half_turn(float(np.degrees(place.yaw)) - (azimuth + 180))
    side = "right" if aside > 0 else "left"
    beside = f", the person {abs(aside):.0f}° {side} of the image's middle"
    looks = f"looks {level}{beside if abs(aside) >= 3 else ''}"
    return f"{place.distance:.1f} m away, {around}, {float(place.height):.1f} m high, {looks}"


def _within_half_turn(degrees: float) -> float:
    return (degrees + 180) % 360 - 180
