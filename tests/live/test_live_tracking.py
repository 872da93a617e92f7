"""What a live run asks of tracker and smoother: when, with which markers, in which order.

Both are stand-ins that keep what they are asked; the real ones have tests of their own.
"""

from concurrent.futures import Future
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest

from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.capture.streams.cameras import LiveVideo
from jaxmocap.capture.streams.inbox import LiveFrame
from jaxmocap.capture.streams.sample_assembly import MarkerSample
from jaxmocap.formats.recordings.filters import OneEuroSettings
from jaxmocap.formats.recordings.recording import MarkerPlace
from jaxmocap.hybrid.settings import Settings
from jaxmocap.pipelines.live import tracking as live_tracking
from jaxmocap.pipelines.live.frame_pace import LONGEST_WAIT_S, MOST_BUSY, FramePace
from jaxmocap.pipelines.live.setup import LiveSetup
from jaxmocap.pipelines.live.tracking import LiveTracking
from jaxmocap.smoothing.fixed_lag import SmoothedPose

SKELETON = Skeleton.human(1.75)
POSE = Pose(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(len(SKELETON.tree.joints)))
IMAGE = np.zeros((4, 4), np.uint8)


class State(NamedTuple):
    time: float | None


class Report(NamedTuple):
    placed: bool
    elbow_deviations: np.ndarray
    marker_pose: Pose


class Tracker:
    """Keeps its steps; its state is the time of the last of them."""

    def __init__(self, cameras: int = 1):
        lenses = SimpleNamespace(size=np.full((cameras, 2), 4)) if cameras else None
        markers = SimpleNamespace(bones=np.zeros(3, int))
        self.model = SimpleNamespace(skeleton=SKELETON, markers=markers, cameras=lenses)
        self.settings = Settings()
        self.steps: list[tuple[float, np.ndarray, object]] = []
        self.solved: list[np.ndarray] = []

    def init(self, markers_world):
        return State(None)

    def step(self, state, time, markers_world, images):
        self.steps.append((time, markers_world, images))
        self.elapsed = None if state.time is None else time - state.time
        return State(time), POSE, Report(False, np.array([0.02, 0.04]), POSE)

    def solve(self, state, markers_world):
        self.solved.append(markers_world)
        return state, POSE, Report(False, np.full(2, np.nan), POSE)


class Smoother:
    """Every event is final at once."""

    def __init__(self, model, settings):
        self.times: list[float] = []
        self.markers: list[np.ndarray] = []
        self.images: list[object] = []

    def step(self, time, markers_world, images, report):
        self.times.append(time)
        self.markers.append(markers_world)
        self.images.append(images)
        pose = report.marker_pose
        deviations = np.zeros((len(LANDMARKS), 3))
        return [SmoothedPose(len(self.times) - 1, time, pose, deviations, np.zeros(len(LANDMARKS)))]

    def lies_between(self, time, images, markers_world):
        return False

    def flush(self):
        return []


@pytest.fixture
def tracking(monkeypatch):
    """Makes a LiveTracking on stand-ins."""

    def make(
        smooth: bool = False, cameras: int = 1, one_euro=None, offset: float = 0.0
    ) -> LiveTracking:
        monkeypatch.setattr(LiveTracking, "_warm_up", lambda self: None)
        monkeypatch.setattr(live_tracking, "FixedLagSmoother", Smoother)
        video = LiveVideo("cam", SimpleNamespace(), 0, offset=offset)  # type: ignore[arg-type]
        places = tuple(MarkerPlace(name, "head") for name in "abc")
        cams = (video,) * cameras
        setup = LiveSetup(Path("live.toml"), SKELETON, places, np.eye(3), cams, one_euro=one_euro)
        return LiveTracking(setup, Settings(), smooth, Tracker(cameras))  # type: ignore[arg-type]

    return make


def sample(time: float, missing: tuple[int, ...] = (), late: float = 0.0) -> MarkerSample:
    """Three markers that move along x with 1 m/s."""
    points = np.array([[time, i, 0.0] for i in range(3)])
    points[list(missing)] = np.nan
    return MarkerSample(time, points, time + late)


def frame(time: float, delay: float = 0.0, camera: int = 0) -> LiveFrame:
    return LiveFrame(camera, time, IMAGE, time + delay)


def test_every_sample_gives_a_pose_at_once_and_frames_give_none(tracking):
    live = tracking()
    for i in range(6):
        outputs = live.sample(sample(i / 90, late=0.002))
        assert [output.time for output in outputs] == [i / 90]
        assert outputs[0].arrived == i / 90 + 0.002
        assert not live.frames([frame(i / 90 + 0.003)])
    assert outputs[0].deviations.tolist() == [0.02, 0.04]


@pytest.mark.parametrize("smooth", [False, True])
def test_while_programs_compile_the_markers_poses_go_out(tracking, smooth):
    live, compiling = tracking(smooth), Future()
    live._compiling = compiling
    assert not live.sample(sample(-1 / 90)) and not live.has_markers_poses
    live._can_solve.set()
    for i in range(4):
        outputs = live.sample(sample(i / 90))
        assert [output.time for output in outputs] == [i / 90]
        assert np.isnan(outputs[0].deviations).all()
        assert not live.frames([frame(i / 90 + 0.003)])
    assert not live.is_ready and not live.tracker.steps and len(live.tracker.solved) == 4
    compiling.set_result(None)
    assert live.is_ready
    live.sample(sample(4 / 90))
    live.frames([frame(4.5 / 90)])
    if smooth:
        # The markers' next sample could be older.
        assert live._smoother.times[-1] == pytest.approx(4 / 90)
        live.sample(sample(5 / 90))
        assert live._smoother.times[-1] == pytest.approx(4.5 / 90)
    else:
        assert live.tracker.steps[-1][0] == pytest.approx(4.5 / 90)


def test_what_goes_wrong_while_programs_compile_ends_the_run(tracking):
    live = tracking()
    live._compiling = Future()
    live._compiling.set_exception(MemoryError("no room"))
    with pytest.raises(MemoryError, match="no room"):
        live.sample(sample(0.0))


def test_a_frame_is_refined_with_the_markers_of_its_own_time(tracking):
    live = tracking(cameras=2)
    for i in range(6):
        live.sample(sample(i / 90))
    live.frames([frame(2.5 / 90, delay=0.05, camera=1)])
    time, markers, images = live.tracker.steps[-1]
    assert time == pytest.approx(2.5 / 90) and images == [None, IMAGE]
    np.testing.assert_allclose(markers[:, 0], 2.5 / 90, atol=1e-9)


def test_a_missing_marker_is_carried_on_for_a_moment_and_then_missing(tracking):
    live = tracking()
    for i in range(4):
        live.sample(sample(i / 90))
    actual = []
    for i in range(4, 8):
        live.sample(sample(i / 90, missing=(1,)))
        actual.append(live.tracker.steps[-1][1][1])
    np.testing.assert_allclose(actual[0], [4 / 90, 1, 0], atol=1e-6)
    assert np.isnan(actual[1:]).all()


def test_tracking_begins_with_all_markers_or_after_a_while_with_some(tracking):
    live = tracking()
    assert not live.sample(sample(0.0, missing=(2,))) and not live.frames([frame(0.0)])
    assert live.sample(sample(0.1))
    patient = tracking()
    outputs = [patient.sample(sample(i / 90, missing=(2,))) for i in range(60)]
    assert not outputs[0] and outputs[-1]
    blind = tracking()
    assert not any(blind.sample(sample(i / 90, missing=(0, 1, 2))) for i in range(60))


def test_in_a_long_run_the_trackers_seconds_pass_as_they_do(tracking):
    """Days after it began a hundredth of a second is still one: times are float64 on the host."""
    live = tracking()
    for i in range(5):
        time = 100.0 + 86400.0 * i
        live.sample(sample(time))
        live.frames([frame(time + 0.01)])
        live.sample(sample(time + 0.02))
        assert live.tracker.elapsed == pytest.approx(0.01, abs=1e-4)


def test_smoothing_has_samples_and_frames_in_the_order_of_their_times(tracking):
    live = tracking(smooth=True)
    outputs = []
    for i in range(60):
        outputs += live.sample(sample(i / 90))
        if i % 3 == 2:
            # Exposed two samples ago.
            outputs += live.frames([frame((i - 1.5) / 90, delay=1.5 / 90)])
    outputs += live.flush()
    times = live._smoother.times
    assert (np.diff(times) > 0).all() and live.late_events == 0
    assert [output.time for output in outputs] == [i / 90 for i in range(60)]
    assert all(output.time == output.arrived for output in outputs)
    at_frames = [
        m for t, m in zip(times, live._smoother.markers, strict=True) if abs(t * 90 % 1 - 0.5) < 0.1
    ]
    assert len(at_frames) == 20 and np.isnan(at_frames).all()


def test_the_smoother_has_the_frames_and_the_tracker_the_markers_alone(tracking):
    live = tracking(smooth=True)
    live.sample(sample(0.0))
    live.frames([frame(0.01)])
    smoother = live._smoother
    live.flush()
    assert not live.tracker.steps and len(live.tracker.solved) == 2
    assert [each is not None for each in smoother.images] == [False, True]


def test_smoothing_waits_for_frames_no_longer_than_a_moment(tracking):
    live = tracking(smooth=True)
    outputs = [output for i in range(60) for output in live.sample(sample(i / 90))]
    assert outputs[-1].time >= 59 / 90 - 0.12
    live.frames([frame(0.1, delay=0.5)])
    assert live.late_events == 1


@pytest.mark.parametrize("smooth", [False, True])
def test_without_a_camera_elbows_are_by_markers_alone_and_nothing_waits_for_it(tracking, smooth):
    live = tracking(smooth)
    seen, late = [], []
    for i in range(180):
        each = live.sample(sample(i / 90))
        if i < 90 and i % 3 == 2:
            each += live.frames([frame(i / 90 - 0.001, delay=0.001)])
        seen += [np.isfinite(output.deviations).all() for output in each if 0.3 < output.time < 1]
        late += [output for output in each if output.time > 1.35]
    assert all(seen) and np.isnan([output.deviations for output in late]).all()
    # Each sample's pose comes with the sample.
    assert [output.time for output in late][-1] == 179 / 90


def test_smoothing_without_cameras_waits_for_none_and_states_deviations(tracking):
    live = tracking(smooth=True, cameras=0)
    for i in range(60):
        (output,) = live.sample(sample(i / 90))
        assert output.time == i / 90 and np.isfinite(output.deviations).all()


def test_markers_go_through_the_one_euro_filter_where_that_is_asked_for(tracking):
    rng = np.random.default_rng(0)
    jitter = rng.normal(0, 0.002, (90, 3, 3))
    spreads = []
    for one_euro in (None, OneEuroSettings(cutoff=1.0)):
        live = tracking(one_euro=one_euro)
        for i, points in enumerate(jitter):
            live.sample(MarkerSample(i / 90, points, i / 90))
        spreads.append(np.std([markers for _, markers, _ in live.tracker.steps[45:]]))
    assert spreads[0] == pytest.approx(0.002, rel=0.1) and spreads[1] < 0.6 * spreads[0]


@pytest.mark.parametrize("delays", [(0.04,), (0.12,), (0.2,), (0.04, 0.08), (0.03, 0.09)])
def test_no_frame_is_too_late_whatever_each_cameras_delay_is(tracking, delays):
    live = tracking(True, len(delays), offset=-max(delays))
    events: list = [(i / 90, sample(i / 90)) for i in range(180)]
    for camera, delay in enumerate(delays):
        taken = 0.003 + 0.008 * camera + np.arange(60) / 30
        events += [(time + delay, frame(float(time), delay, camera)) for time in taken]
    for _, event in sorted(events, key=lambda each: each[0]):
        if isinstance(event, MarkerSample):
            live.sample(event)
        else:
            live.frames([event])
    live.flush()
    # But the first of a camera that begins after another.
    assert live.late_events <= 2 * (len(delays) - 1)
    assert (np.diff(live._smoother.times) > 0).all()
    for camera in range(len(delays)):
        shown = [images is not None and images[camera] is not None for images in
                 live._smoother.images]  # fmt: skip
        assert sum(shown) >= 60 - 5 * max(delays) * 30


def test_elbows_are_not_stated_by_frames_that_were_too_late(tracking):
    live = tracking(True)
    outputs = []
    for i in range(90):
        outputs += live.sample(sample(i / 90))
        if i % 3 == 2:
            outputs += live.frames([frame(i / 90 - 0.3, 0.3)])
    assert live.late_events > 20 and np.isnan(outputs[-1].deviations).all()


@pytest.mark.parametrize(("rate", "delay"), [(90, 0.12), (120, 0.12), (250, 0.06), (1000, 0.03)])
def test_markers_are_known_when_a_late_frame_was_taken(tracking, rate, delay):
    live = tracking()
    for i in range(rate):
        live.sample(sample(i / rate))
    taken = 1 - delay
    live.frames([frame(taken, delay)])
    np.testing.assert_allclose(live.tracker.steps[-1][1][:, 0], taken, atol=1e-6)


@pytest.mark.parametrize("offset", [-0.05, 0.0, 0.03, 0.1])
def test_frames_that_are_ahead_of_the_markers_cost_no_pose(tracking, offset):
    """Markers come up to 30 ms late, frames at once: every sample has a pose, in order."""
    live, rng = tracking(smooth=True, offset=offset), np.random.default_rng(0)
    moments = np.arange(90) / 90
    late = np.maximum.accumulate(moments + rng.uniform(0, 0.03, 90)) - moments
    arrivals = [sample(i / 90, late=late[i] + 1e-6 * i) for i in range(90)]
    arrivals += [frame(i / 30 + 0.003 + offset, delay=0.0) for i in range(30)]
    # When each came: of a frame with a delay, later than it was taken.
    came = [each.arrived - (offset if isinstance(each, LiveFrame) else 0) for each in arrivals]
    times = []
    for _, event in sorted(zip(came, arrivals, strict=True), key=lambda pair: pair[0]):
        if isinstance(event, LiveFrame):
            outputs = live.frames([event._replace(arrived=event.time - offset)])
        else:
            outputs = live.sample(event)
        times += [output.time for output in outputs]
    times += [output.time for output in live.flush()]
    assert live.late_events == 0
    np.testing.assert_allclose(times, np.arange(90) / 90)


def test_a_camera_that_is_late_by_half_a_second_counts(tracking):
    live = tracking(offset=-0.5)
    for i in range(90):
        outputs = live.sample(sample(i / 90))
        if i >= 45:
            live.frames([frame(i / 90 - 0.5, delay=0.5)])
    assert np.isfinite(outputs[0].deviations).all()


# The pace of frames -------------------------------------------------------------------------------


FPS, SECONDS = 30, 10


def run(seconds_a_frame: float, seconds_between: float = 0.0) -> tuple[list[float], float]:
    """When frames are taken that take so long, with other work in between; share of time worked."""
    pace, taken, now, worked = FramePace(), [], 0.0, 0.0
    for i in range(FPS * SECONDS):
        began, now = now, max(now, i / FPS)
        work = seconds_between
        if pace.is_due(now):
            pace.took_frame(now)
            taken.append(now)
            work += seconds_a_frame
        pace.count_work(work, now + work - began)
        now, worked = now + work, worked + work
    return taken, worked / now


def test_all_are_taken_where_there_is_the_time():
    assert len(run(0.02)[0]) == FPS * SECONDS


@pytest.mark.parametrize("seconds", [0.035, 0.05, 0.08])
def test_as_many_are_taken_as_leave_the_others_some_time(seconds):
    taken, share = run(seconds, 0.001)
    assert MOST_BUSY - 0.1 < share < MOST_BUSY + 0.05
    assert len(taken) > 0.8 * SECONDS * MOST_BUSY / (seconds + 0.002)


def test_some_are_taken_whatever_else_there_is_to_do():
    taken, _ = run(0.02, 0.04)
    assert len(taken) > 0.5 * SECONDS / LONGEST_WAIT_S
