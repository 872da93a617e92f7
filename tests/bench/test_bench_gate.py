"""The benchmark's figures: as JSON, as a table, and against the committed ratios."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_recording import small_recording

from bench import figures
from bench.clips import Footage, at_size
from bench.clock import SIDE, image_chain
from bench.figures import OF_OTHERS, Metric, stage_metrics, table, write_json
from jaxmocap.capture.video import open_video
from jaxmocap.geometry.cameras import project

SLOWER = Metric("step_over_chain", 2.0, "x", "lower", 0.25)
FASTER = Metric("reference_over_ours", 50.0, "x", "higher", 0.25)
positive = st.floats(0.01, 100.0)


def with_value(metric: Metric, value: float) -> Metric:
    return replace(metric, value=value)


# The gate ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("committed", "within", "beyond"), [(SLOWER, 2.49, 2.51), (FASTER, 40.1, 39.9)]
)
def test_only_what_is_worse_by_more_than_its_tolerance_fails(committed, within, beyond):
    assert figures.failures([with_value(committed, within)], [committed]) == []
    (message,) = figures.failures([with_value(committed, beyond)], [committed])
    assert message.startswith(committed.name) and f"{beyond:.3g}" in message and "25%" in message


@given(positive, st.sampled_from([SLOWER, FASTER]))
def test_what_is_better_never_fails(factor, committed):
    better = committed.value * (1 + factor if committed.direction == "higher" else 1 / (1 + factor))
    assert figures.worsening(with_value(committed, better), committed) < 0
    assert figures.failures([with_value(committed, better)], [committed]) == []


def test_a_ratio_that_was_not_measured_fails_unless_its_rival_is_missing():
    rival = Metric("ik_mink_over_ours", 3.0, "x", "higher")
    (message,) = figures.failures([SLOWER], [SLOWER, rival])
    assert "ik_mink_over_ours: not measured" in message
    assert figures.failures([SLOWER], [SLOWER, rival], skipped=["mink"]) == []


def test_a_ratio_fails_where_it_is_worse_in_each_of_several_runs():
    runs = [
        [with_value(SLOWER, 9.0), with_value(FASTER, 10.0)],
        [with_value(SLOWER, 2.0), with_value(FASTER, 12.0)],
    ]
    assert figures.best(runs) == [with_value(SLOWER, 2.0), with_value(FASTER, 12.0)]
    (message,) = figures.failures(figures.best(runs), [SLOWER, FASTER])
    assert message.startswith(f"{FASTER.name}: 12")


def test_the_baseline_keeps_ratios_only_and_each_mode_by_itself(tmp_path):
    path = tmp_path / "baseline.json"
    figures.write_baseline("quick", [SLOWER, Metric("step", 3.0, "ms")], path)
    figures.write_baseline("full", [FASTER], path)
    assert figures.read_baseline("quick", path) == [SLOWER]
    assert figures.read_baseline("full", path) == [FASTER]


@pytest.mark.parametrize("mode", ["quick", "full"])
def test_the_committed_baseline_holds_ratios_with_room_for_chance(mode):
    committed = figures.read_baseline(mode)
    names = [metric.name for metric in committed]
    assert len(set(names)) == len(names) and "step_over_image_chain" in names
    for metric in committed:
        assert (
            metric.unit == figures.RATIO and metric.value > 0 and 0 < metric.tolerance <= OF_OTHERS
        )
        assert metric.direction in ("lower", "higher")


def test_spread_tells_how_far_runs_scatter_and_writes_their_medians(tmp_path, capsys):
    baseline = tmp_path / "baseline.json"
    for i, value in enumerate((2.0, 2.2, 1.9)):
        write_json([with_value(SLOWER, value), Metric("step", value, "ms")], tmp_path / f"{i}.json")
    runs = [str(tmp_path / f"{i}.json") for i in range(3)]
    figures.main(["baseline", "quick", *runs, "--write", "--file", str(baseline)])
    row = capsys.readouterr().out.splitlines()[1].split()
    assert row == ["step_over_chain", "2", "1.9", "2.2", "10", "25"]
    assert figures.read_baseline("quick", baseline) == [SLOWER]


# Figures -----------------------------------------------------------------------------------------


def test_the_table_puts_late_times_and_committed_values_beside_the_medians():
    actual = [*stage_metrics("solve", [1.0, 2.0, 3.0]), with_value(SLOWER, 2.1)]
    heading, solve, step = table(actual, [SLOWER]).splitlines()
    assert heading.split() == ["median", "99", "%", "unit", "baseline"]
    assert solve.split() == ["solve", "2", "2.98", "ms"]
    assert step.split() == ["step_over_chain", "2.1", "x", "2"]


# What is measured --------------------------------------------------------------------------------


def test_the_bare_chain_measures_how_far_the_nearest_edge_is():
    image = np.zeros((SIDE, SIDE, 3), np.uint8)
    image[:, SIDE // 2 :] = 255
    field, same = image_chain([image, image])
    # Of a 3 x 3 mask, along a row, 0.955 for each pixel.
    edge = int(field[100].argmin())
    assert abs(edge - SIDE // 2) <= 1
    assert field[100, edge + 40] == pytest.approx(0.955 * 40, abs=0.1)
    np.testing.assert_array_equal(field, same)


def test_a_larger_camera_sees_the_same_points_in_the_enlarged_image(tmp_path):
    recording = small_recording()
    video = open_video(recording.videos[0])
    images = [np.dstack([image] * 3) if image.ndim == 2 else image for _, image in video.frames()]
    source = replace(recording.videos[0], path=tmp_path / "video.mp4", frames=None)
    small = Footage(replace(recording, videos=(source,)), video.times, images[:2])
    height, width = images[0].shape[:2]
    large = at_size(small, 3 * width, 2 * height)
    assert large.images[0].shape == (2 * height, 3 * width, 3)
    assert open_video(large.recording.videos[0]).size == (3 * width, 2 * height)
    point = jnp.asarray([[0.1, 0.2, 1.0]])
    (x, y), (u, v) = (np.asarray(project(f.camera, point))[0] for f in (small, large))
    # The image's border lies at -0.5.
    assert u + 0.5 == pytest.approx(2 * (x + 0.5) + width / 2, abs=1e-2)
    assert v + 0.5 == pytest.approx(2 * (y + 0.5), abs=1e-2)
