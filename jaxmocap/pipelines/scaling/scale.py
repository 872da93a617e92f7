"""A person's body by any of the three ways: height, static trial, a recording of movement.

INPUTS: a BodySource. OUTPUTS: subject.toml, what its lengths rest on.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from jaxmocap.calibration import static_trial
from jaxmocap.formats.files.errors import InputError
from jaxmocap.pipelines.progress import Progress


@dataclass(frozen=True)
class BodySource:
    """What a body is made of; one of height, static trial and recording says whose it is.

    Attributes:
        height: metres.
        mass: kilograms.
        static: file of markers of the person standing upright.
        landmarks: landmark -> marker of the static trial.
        up: the static trial's vertical axis, "z" or "y".
        wrists: whether the body gets a neck that turns, forearms that twist, and wrists.
        recording: file of a recording of movement, with video.
    """

    height: float | None = None
    mass: float | None = None
    static: str | Path | None = None
    landmarks: Mapping[str, str] = field(default_factory=dict)
    up: str | None = None
    wrists: bool = False
    recording: str | Path | None = None


def write_body(out: str | Path, source: BodySource, progress: Progress | bool | None = None):
    """Write a body; see ``scale_subject`` and, for a recording, ``scale_by_recording``.

    Raises:
        InputError: options that do not go together.
    """
    if source.recording is None:
        return static_trial.scale_subject(
            out,
            source.height,
            source.static,
            source.landmarks,
            source.up,
            source.mass,
            source.wrists,
        )
    if source.landmarks or source.up or source.wrists:
        problem = (
            "--landmarks, --up and --wrists do not go with --recording, whose file states them"
        )
        raise InputError(source.recording, problem)
    # A recording takes what tracks, which height and static trial do without.
    from jaxmocap.pipelines.kept_programs import keep_compiled
    from jaxmocap.pipelines.scaling.fit_lengths import scale_by_recording

    keep_compiled()
    return scale_by_recording(out, source.recording, source.height, source.mass, progress)
