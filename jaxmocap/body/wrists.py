"""Joints beyond the paper's 21: rotation of the neck, twist of the forearms, wrists.

INPUTS: a Skeleton. OUTPUTS: the same with seven more degrees of freedom (``data/wrists.toml``).

Three points know nothing of them; they are for markers that tell how they are turned.
"""

import tomllib
from dataclasses import replace
from importlib import resources

import jax.numpy as jnp
import numpy as np

from jaxmocap.body.skeleton import Skeleton


def with_wrists(skeleton: Skeleton) -> Skeleton:
    """The skeleton with a neck that turns, forearms that twist and wrists; once is enough."""
    text = resources.files("jaxmocap.body").joinpath("data", "wrists.toml").read_text("utf-8")
    rows = tomllib.loads(text)["joint"]
    tree = skeleton.tree
    if rows[0]["name"] in tree.joints:
        return skeleton
    dtype = skeleton.axes.dtype

    def appended(old: jnp.ndarray, key: str, scale: float = 1.0) -> jnp.ndarray:
        new = np.array([row[key] for row in rows], float) * scale
        return jnp.concatenate([old, jnp.asarray(new, dtype)])

    return replace(
        skeleton,
        tree=replace(
            tree,
            joints=(*tree.joints, *(row["name"] for row in rows)),
            dof_bones=(*tree.dof_bones, *(tree.bone(row["bone"]) for row in rows)),
        ),
        axes=appended(skeleton.axes, "axis"),
        limits=appended(skeleton.limits, "range", np.pi / 180),
        costs=appended(skeleton.costs, "cost"),
        relaxed=appended(skeleton.relaxed, "relaxed", np.pi / 180),
    )
