"""Human motion capture from three tracked points and one ordinary camera, in JAX.

``track`` takes a recording to a motion. ``solve``, ``refine``, ``landmarks`` and ``smooth`` are the
same as pure functions of a ``Model``: jit, vmap and derivatives go through them. The public names
are these; each is loaded when it is first used.
"""

from importlib import import_module

# As ``typing`` has it, which takes as long to import as all else here.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from jaxmocap.body.model import Model
    from jaxmocap.body.motion import Motion, Report
    from jaxmocap.body.pose import Pose
    from jaxmocap.body.skeleton import LANDMARKS, Skeleton
    from jaxmocap.evaluation.errors import evaluate
    from jaxmocap.formats.files.errors import InputError
    from jaxmocap.formats.recordings.recording import Recording
    from jaxmocap.geometry.cameras import Camera
    from jaxmocap.hybrid.functions import Observation, landmarks, observe, refine, smooth, solve
    from jaxmocap.hybrid.settings import Settings
    from jaxmocap.hybrid.step import State
    from jaxmocap.hybrid.tracker import HybridTracker
    from jaxmocap.pipelines.kept_programs import keep_compiled
    from jaxmocap.pipelines.tracking.first_pass import first_pass
    from jaxmocap.pipelines.tracking.track import track
    from jaxmocap.smoothing.functions import Events, SmoothMotion

__version__ = "0.2.0"
__all__ = [
    "LANDMARKS",
    "Camera",
    "Events",
    "HybridTracker",
    "InputError",
    "Model",
    "Motion",
    "Observation",
    "Pose",
    "Recording",
    "Report",
    "Settings",
    "Skeleton",
    "SmoothMotion",
    "State",
    "__version__",
    "evaluate",
    "first_pass",
    "keep_compiled",
    "landmarks",
    "observe",
    "refine",
    "smooth",
    "solve",
    "track",
]

_HOMES = {
    "Camera": "geometry.cameras",
    "Events": "smoothing.functions",
    "HybridTracker": "hybrid.tracker",
    "InputError": "formats.files.errors",
    "LANDMARKS": "body.skeleton",
    "Model": "body.model",
    "Motion": "body.motion",
    "Observation": "hybrid.functions",
    "Pose": "body.pose",
    "Recording": "formats.recordings.recording",
    "Report": "body.motion",
    "Settings": "hybrid.settings",
    "Skeleton": "body.skeleton",
    "SmoothMotion": "smoothing.functions",
    "State": "hybrid.step",
    "evaluate": "evaluation.errors",
    "first_pass": "pipelines.tracking.first_pass",
    "keep_compiled": "pipelines.kept_programs",
    "landmarks": "hybrid.functions",
    "observe": "hybrid.functions",
    "refine": "hybrid.functions",
    "smooth": "hybrid.functions",
    "solve": "hybrid.functions",
    "track": "pipelines.tracking.track",
}


def __getattr__(name: str) -> "Any":
    if name not in _HOMES:
        raise AttributeError(f"module 'jaxmocap' has no attribute {name!r}")
    value = getattr(import_module(f"jaxmocap.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
