"""Where the time goes, and an accelerator beside the CPU: what is drawn and what is compared."""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.patches import Rectangle

from bench.gpu import compared
from bench.where import LIMIT, STAGES, draw, stages_over_chain

FOUND = {
    "solve_over_image_chain": 0.5,
    "observe_over_image_chain": 1.5,
    "refine_over_image_chain": 2.0,
    "smooth_over_image_chain": 8.0,
    "tracker_step_over_image_chain": 5.0,
    "step_over_image_chain": 13.0,
}


def test_the_stages_and_the_rest_make_up_the_whole_step():
    bars = stages_over_chain(FOUND)
    assert sum(bars["frame by frame"].values()) == pytest.approx(5.0)
    assert sum(bars["causal, smoothed"].values()) == pytest.approx(13.0)
    assert {stage for bar in bars.values() for stage in bar} == {*STAGES, "rest"}
    assert "refine" not in bars["causal, smoothed"], "it is refined on demand"


def test_the_picture_shows_every_stage_and_the_limit():
    figure, axes = plt.subplots()
    draw(axes, stages_over_chain(FOUND))
    ends = [bar.get_x() + bar.get_width() for bar in axes.patches if isinstance(bar, Rectangle)]
    assert max(ends) == pytest.approx(13.0)
    assert any(np.allclose(np.asarray(line.get_xdata(), float), LIMIT) for line in axes.lines)
    plt.close(figure)


def test_two_devices_are_held_against_each_other():
    (cpu,) = {device for device in jax.devices("cpu")[:1]}
    actual = compared("doubling", (lambda x: 2 * x, (jnp.ones(3),)), {"cpu": cpu, "other": cpu})
    values = {metric.name: metric.value for metric in actual}
    assert values["doubling, other from cpu at most"] == 0
    assert values["doubling, cpu"] > 0 and values["doubling, cpu over other"] > 0
