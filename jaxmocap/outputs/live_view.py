"""A live run in the rerun viewer: the body, the cameras' images, deviations and latency.

INPUTS: a viewer's address; poses and frames. OUTPUTS: none; the viewer shows them.

A thread sends the newest snapshot at a limited rate, so that a slow viewer delays nothing.
"""

from collections.abc import Mapping
from threading import Event, Lock, Thread
from typing import NamedTuple

import numpy as np
import rerun as rr

from jaxmocap.body.motion import Motion
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surfaces.pieces import body_pieces
from jaxmocap.geometry.cameras import Camera
from jaxmocap.outputs import camera_recorder, layout, recorder
from jaxmocap.outputs.scene import BodyScene, floor_of, make_scene

# Seconds between snapshots that are sent.
INTERVAL_S = 1 / 25
# ``close`` waits at most so many seconds for the one being sent.
CLOSE_TIMEOUT_S = 3.0
LATENCY = "latency"
SERIES = {name: layout.SERIES[name] for name in (layout.ANGLES, layout.DEVIATIONS)}
SERIES |= {"milliseconds": "Latency [ms]"}
JPEG_QUALITY = 60


class LiveSnapshot(NamedTuple):
    """What is shown of one moment."""

    time: float  # seconds
    pose: Pose
    deviations: np.ndarray  # (2,) standard deviations of the elbows, metres; NaN where unknown
    latency_ms: float  # from the sample to the pose
    images: Mapping[str, np.ndarray]  # camera -> newest image (H, W, 3) BGR


class LiveView:
    """Shows one person; ``problem`` is why nothing more is shown."""

    def __init__(self, url: str, skeleton: Skeleton, cameras: Mapping[str, Camera], pose: Pose):
        """Connect to ``rerun+http://...``, and lay out about where the person will stand."""
        self._skeleton, self._cameras = skeleton, dict(cameras)
        self.problem: str | None = None
        self._stream = rr.RecordingStream("jaxmocap live")
        self._stream.connect_grpc(url)
        standing, pieces = self._scene(0.0, pose), body_pieces(skeleton)
        floor = floor_of(standing, pieces)
        fields = {name: [] for name in cameras}
        self._stream.send_blueprint(layout.lay_out(fields, standing, floor, SERIES, live=True))
        recorder.log_pieces(self._stream, skeleton.tree, pieces, floor)
        recorder.log_body(self._stream, standing)
        self._joints = recorder.shown_joints(skeleton.tree)
        lines = {layout.ANGLES: self._joints, layout.DEVIATIONS: recorder.SIDES}
        for root, names in (lines | {"milliseconds": (LATENCY,)}).items():
            for i, name in enumerate(names):
                recorder.log_line(self._stream, root, name, i)
        for name, camera in cameras.items():
            camera_recorder.log_camera(self._stream, name, camera)
        self._lock, self._stop, self._newest = Lock(), Event(), None
        self._thread = Thread(target=self._send, name="viewer", daemon=True)
        self._thread.start()

    def show(self, snapshot: LiveSnapshot) -> None:
        """Show this soon, unless a newer one comes first."""
        with self._lock:
            images = {} if self._newest is None else self._newest.images
            self._newest = snapshot._replace(images={**images, **snapshot.images})

    def close(self) -> None:
        """Send what is left; returns within ``CLOSE_TIMEOUT_S``, though a viewer may not answer."""
        self._stop.set()
        self._thread.join(CLOSE_TIMEOUT_S)

    def _send_newest(self) -> None:
        with self._lock:
            snapshot, self._newest = self._newest, None
        if snapshot is not None:
            self._log(snapshot)

    def _send(self) -> None:
        try:
            while not self._stop.wait(INTERVAL_S):
                self._send_newest()
            self._send_newest()
        # Whatever the viewer's library raises, the run goes on without it.
        except Exception as error:
            self.problem = f"nothing more is shown ({type(error).__name__})"
        finally:
            self._stream.disconnect()

    def _scene(self, time: float, pose: Pose) -> BodyScene:
        poses = Pose(*(np.asarray(part)[None] for part in pose))  # type: ignore[arg-type]
        return make_scene(Motion(self._skeleton, np.array([time]), poses))

    def _log(self, snapshot: LiveSnapshot) -> None:
        scene = self._scene(snapshot.time, snapshot.pose)
        recorder.log_body(self._stream, scene)
        self._stream.set_time(layout.TIMELINE, duration=snapshot.time)
        for name, image in snapshot.images.items():
            camera_recorder.log_images(self._stream, name, [(snapshot.time, image)], JPEG_QUALITY)
            camera_recorder.log_outlines(
                self._stream, name, self._cameras[name], scene, np.array([snapshot.time])
            )
        angles = np.degrees(np.asarray(snapshot.pose.angles, float))
        deviations = 100 * np.asarray(snapshot.deviations, float)
        joints = {name: float(angles[i]) for name, i in self._joints.items()}
        elbows = {s: float(d) for s, d in zip(recorder.SIDES, deviations, strict=True)}
        recorder.log_values(self._stream, layout.ANGLES, joints)
        recorder.log_values(self._stream, layout.DEVIATIONS, elbows)
        recorder.log_values(self._stream, "milliseconds", {LATENCY: snapshot.latency_ms})
