"""The bench of faults: what is done to recordings, and how outcomes are reported."""

import numpy as np
import pytest

from bench.robustness import (
    JOINTS,
    Faulty,
    Span,
    all_corrupted,
    back_at,
    camera_lost,
    evaluated,
    one_corrupted,
    torn,
    unseen,
)
from jaxmocap.body.motion import Motion, Report
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.formats.recordings.recording import VideoSource
from jaxmocap.synthetic.drawing_camera import look_at

FRAMES = 45


@pytest.fixture
def videos() -> list[VideoSource]:
    """Two cameras whose frames are all different."""
    times, camera = np.arange(FRAMES) / 30, look_at((3.0, 0.0, 1.0), (0.0, 0.0, 1.0))
    rng = np.random.default_rng(0)
    return [
        VideoSource(name, camera, frames=(times, list(rng.integers(1, 255, (FRAMES, 6, 9, 3)))))
        for name in ("a", "b")
    ]


def differing(before: VideoSource, after: VideoSource) -> list[int]:
    assert before.frames is not None and after.frames is not None
    pairs = zip(before.frames[1], after.frames[1], strict=True)
    return [i for i, (old, new) in enumerate(pairs) if not np.array_equal(old, new)]


def test_every_tenth_frame_of_all_cameras_is_corrupted_and_no_other(videos):
    faulty = all_corrupted(videos, {})
    for before, after in zip(videos, faulty.videos, strict=True):
        assert differing(before, after) == [10, 20, 30, 40]
    (_, a), (_, b) = (video.frames for video in faulty.videos)
    assert not a[20].any() and np.array_equal(a[30], videos[1].frames[1][30])
    assert np.array_equal(a[10], torn(videos[0].frames[1][10]))
    assert [span.cameras for span in faulty.spans] == 4 * [("a", "b")] and not b[20].any()


def test_one_camera_after_the_other_is_corrupted_in_all_three_ways(videos):
    faulty = one_corrupted(videos, {})
    assert differing(videos[0], faulty.videos[0]) == [10, 20, 30]
    assert differing(videos[1], faulty.videos[1]) == [40]
    assert [span.cameras for span in faulty.spans] == [("a",), ("a",), ("a",), ("b",)]


def test_a_lost_camera_ends_midway_and_the_others_are_left(videos):
    faulty = camera_lost(videos, {})
    assert len(faulty.videos[1].frames[1]) == FRAMES // 2 and faulty.fewer == ("a",)
    assert faulty.videos[0] is videos[0]


def test_who_is_well_for_one_frame_only_is_not_back():
    within = np.array([True, False, True, False, True, True, True, True])
    assert back_at(within, 1, 8) == 4
    assert back_at(within, 7, 8) == 7
    assert back_at(np.zeros(5, bool), 0, 5) > 5


def test_times_and_reports_are_given_for_each_fault():
    span = Span(10, 11, ("a",))
    faulty = Faulty((), (span, Span(20, 21, ("a",))))
    usual = np.full((FRAMES, len(JOINTS)), 0.01)
    off = usual.copy()
    off[10:14, 3], off[20, 5] = 0.2, 0.2
    statuses: list[tuple[str, ...]] = [()] * FRAMES
    statuses[10] = statuses[30] = tuple(unseen(span))
    none = np.zeros((FRAMES, 0))
    report = Report((), none, none, none, none, none, tuple(statuses))
    still = Pose(np.zeros((FRAMES, 3)), np.zeros((FRAMES, 4)), none)  # type: ignore[arg-type]
    motion = Motion(Skeleton.human(), np.arange(FRAMES) / 30, still, report)
    outcome = evaluated("made up", motion, off, usual, faulty)
    np.testing.assert_allclose(outcome.back, [4 / 30, 1 / 30])
    assert outcome.reported == 0.5 and outcome.false == pytest.approx(1 / (FRAMES - 2))
    assert outcome.worst == pytest.approx((11 * 0.01 + 0.2) / 12)
