"""A person's body by any of the three ways: height, static trial, a recording of movement.

INPUTS: what the command was given. OUTPUTS: subject.toml, what its lengths rest on.
"""

from collections.abc import Mapping
from pathlib import Path

from jaxmocap.calibration import static_trial as at_rest
from jaxmocap.formats.files.errors import InputError
from jaxmocap.pipelines.progress import Progress


def scale(
    out: str | Path,
    height: float | None = None,
    static: str | Path | None = None,
    recording: str | Path | None = None,
    landmarks: Mapping[str, str] | None = None,
    up: str | None = None,
    mass: float | None = None,
    wrists: bool = False,
    progress: Progress | bool | None = None,
):
    """Write a body; see ``setup.scale_subject`` and, for a recording, ``run.lengths``.

    Raises:
        InputError: options that do not go together.
    """
    if recording is None:
        return at_rest.scale_subject(out, height, static, landmarks, up, mass, wrists)
    if landmarks or up or wrists:
        problem = "--landmarks, --up and --wrists do not go with --recording, whose file says them"
        raise InputError(out, problem)
    # A recording takes what tracks, which height and static trial do without.
    from jaxmocap.pipelines.kept_programs import keep_compiled
    from jaxmocap.pipelines.scaling.fit_lengths import scale_by_recording

    keep_compiled()
    return scale_by_recording(out, recording, height, mass, progress)
