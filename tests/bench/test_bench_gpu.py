"""An accelerator beside the CPU: what is compared."""

import jax
import jax.numpy as jnp

from bench.gpu import compared


def test_two_devices_are_held_against_each_other():
    (cpu,) = {device for device in jax.devices("cpu")[:1]}
    actual = compared("doubling", (lambda x: 2 * x, (jnp.ones(3),)), {"cpu": cpu, "other": cpu})
    values = {metric.name: metric.value for metric in actual}
    assert values["doubling, other from cpu at most"] == 0
    assert values["doubling, cpu"] > 0 and values["doubling, cpu over other"] > 0
