"""The recording that somebody asks for: some of its cameras, a person of another height.

INPUTS: a Recording. OUTPUTS: a Recording.
"""

from collections.abc import Sequence
from dataclasses import replace

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.recording import Recording


def with_height(recording: Recording, height: float) -> Recording:
    """The recording of a person of another height (metres), by published proportions.

    Raises:
        InputError: nobody's height.
    """
    try:
        return replace(recording, skeleton=Skeleton.human(height))
    except ValueError as error:
        raise InputError(recording.path or recording.name, str(error)) from None


def select_cameras(recording: Recording, names: Sequence[str]) -> Recording:
    """The recording with some of its cameras, in their order there.

    Raises:
        InputError: a name that it does not have.
    """
    there = [source.camera_name for source in recording.videos]
    for name in names:
        if name not in there:
            problem = f"no [[video]] of camera {name!r}, found {', '.join(there) or 'no video'}"
            raise InputError(recording.path or recording.name, problem)
    chosen = tuple(source for source in recording.videos if source.camera_name in names)
    return replace(recording, videos=chosen)
