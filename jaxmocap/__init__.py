"""Human motion capture from three tracked points and one ordinary camera, in JAX.

The public names are these; each is loaded when it is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxmocap.body.motion import Motion, Report
    from jaxmocap.body.pose import Pose
    from jaxmocap.body.skeleton import Skeleton
    from jaxmocap.evaluation.motions import evaluate
    from jaxmocap.formats.files.errors import InputError
    from jaxmocap.formats.recordings.recording import Recording
    from jaxmocap.geometry.cameras import Camera
    from jaxmocap.hybrid.settings import Settings
    from jaxmocap.hybrid.tracker import HybridTracker, State
    from jaxmocap.pipelines.tracking.track import track

__version__ = "0.1.0"
__all__ = [
    "Camera",
    "HybridTracker",
    "InputError",
    "Motion",
    "Pose",
    "Recording",
    "Report",
    "Settings",
    "Skeleton",
    "State",
    "__version__",
    "evaluate",
    "track",
]

_HOMES = {
    "Camera": "geometry.cameras",
    "HybridTracker": "hybrid.tracker",
    "InputError": "formats.files.errors",
    "Motion": "body.motion",
    "Pose": "body.pose",
    "Recording": "formats.recordings.recording",
    "Report": "body.motion",
    "Settings": "hybrid.settings",
    "Skeleton": "body.skeleton",
    "State": "hybrid.tracker",
    "evaluate": "evaluation.motions",
    "track": "pipelines.tracking.track",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'jaxmocap' has no attribute {name!r}")
    value = getattr(import_module(f"jaxmocap.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
