"""Which video frames are taken where tracking all of them would take too long."""

import pytest

from jaxmocap.pipelines.live.frame_pace import LONGEST_WAIT_S, MOST_BUSY, FramePace

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
