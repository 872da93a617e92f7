"""The four figures that users pay by: their names, the clip that is cut, an absent detector."""

import sys
from pathlib import Path

import numpy as np
import pytest

from bench import __main__ as command
from bench.clips import Footage
from bench.headline import NAMES
from bench.rival_detector import detector
from jaxmocap.pipelines.demo import standing_recording


def test_the_figures_have_the_names_that_others_ask_for():
    assert NAMES == (
        "core_share_720p",
        "frame_p99_ms",
        "offline_core_seconds",
        "ours_over_detector",
    )


def test_the_headline_is_a_part_that_is_asked_for_by_name():
    options = command.parser().parse_args(["--only", "headline", "--detector-python", "python"])
    assert options.only == "headline" and options.detector_python == "python"
    assert options.recordings is None


def test_the_first_frames_come_with_the_markers_until_the_last_of_them():
    recording = standing_recording(9)
    times, images = recording.videos[0].frames
    footage = Footage(recording, np.asarray(times), list(images))
    first = footage.first(4)
    assert len(first.images) == len(first.times) == 4
    assert first.recording.times[-1] <= times[3]
    assert len(first.recording.positions_world) == len(first.recording.times)
    assert len(footage.images) == 9


def test_a_python_without_the_detector_is_refused():
    with (
        pytest.raises(RuntimeError, match="pose detector does not start"),
        detector(sys.executable, Path("no.mp4")),
    ):
        raise AssertionError("it must not begin")
