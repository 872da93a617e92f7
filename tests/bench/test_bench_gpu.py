"""An accelerator beside the CPU: what is compared, and that it multiplies as precisely."""

from pathlib import Path

import jax
import jax.numpy as jnp
from products import coarse_products

from bench.clips import film
from bench.gpu import compared, parts


def test_two_devices_are_held_against_each_other():
    (cpu,) = {device for device in jax.devices("cpu")[:1]}
    actual = compared("doubling", (lambda x: 2 * x, (jnp.ones(3),)), {"cpu": cpu, "other": cpu})
    values = {metric.name: metric.value for metric in actual}
    assert values["doubling, other from cpu at most"] == 0
    assert values["doubling, cpu"] > 0 and values["doubling, cpu over other"] > 0


def test_products_run_at_full_precision(tmp_path: Path):
    """By default a GPU takes ten of float32's 23 bits."""
    found = {name: coarse_products(*_flat(work)) for name, work in parts(film(tmp_path, 0.3), [1])}
    assert {name: where for name, (_, where) in found.items() if where} == {}
    assert sum(count for count, _ in found.values()) > 10


def _flat(work):
    call, arguments = work
    return call, *arguments
