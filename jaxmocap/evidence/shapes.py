"""What shapes a model, a pose and measurements have, checked at the door of the public functions.

INPUTS: what a user calls a function with. OUTPUTS: the same as arrays of the model's precision, or
an error of one sentence.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose
from jaxmocap.compilation.arguments import (
    check_kind,
    check_settings,
    check_shape,
    checked_parts,
    floating,
)
from jaxmocap.evidence.terms import Measurements
from jaxmocap.geometry.cameras import Camera
from jaxmocap.geometry.lenses import LENSES

# What every event must bring; others, such as elbows, may be missing.
NEEDED = ("markers", "upright", "facing", "ankles")


def check_arguments(model: Any, settings: Any, kind: type) -> tuple[Model, Any]:
    """A model, and settings of a kind in its precision.

    Raises:
        TypeError: others.
        ValueError: an array of another shape; several numbers in place of a setting.
    """
    model = check_model(model)
    check_settings("settings", settings, kind)
    return model, in_precision(model, settings)


def in_precision(model: Model, tree: Any) -> Any:
    """The floating-point leaves of anything, as precise as the model's."""

    def convert(leaf: Any) -> Any:
        array = jnp.asarray(leaf)
        floating = jnp.issubdtype(array.dtype, jnp.floating)
        return array.astype(model.dtype) if floating else leaf

    return jax.tree.map(convert, tree)


def check_model(model: Any) -> Model:
    """A model, all of it in the precision of its bones' lengths.

    Raises:
        TypeError: no model, or other than floating-point numbers in it.
        ValueError: an array of another shape than its names and counts ask for.
    """
    check_kind("model", model, Model)
    skeleton, markers, cameras = model.skeleton, model.markers, model.cameras
    if not jnp.issubdtype(dtype := getattr(skeleton.lengths, "dtype", object), jnp.floating):
        found = type(skeleton.lengths).__name__ if dtype is object else f"an array of {dtype}"
        raise TypeError(f"model.skeleton.lengths: found {found}, expected an array of floats")
    M = len(markers.bone_indices)
    on_bones = {"at": (M,), "offsets": (M, 3)}
    return replace(
        model,
        skeleton=_part("skeleton", skeleton, skeleton.shapes, dtype),
        markers=_part("markers", markers, on_bones, dtype),
        cameras=cameras and _part("cameras", cameras, _camera_shapes(cameras), dtype),
    )


def _part(name: str, part: Any, shapes: Mapping[str, tuple[int, ...]], dtype: Any) -> Any:
    return checked_parts(f"model.{name}", part, type(part), shapes, dtype)


def _camera_shapes(cameras: Camera) -> dict[str, tuple[int, ...]]:
    """Of C cameras, stacked."""
    stacked = np.shape(cameras.T_cam_world)
    C = stacked[-3] if len(stacked) > 2 else 1
    coefficients = len(LENSES[cameras.lens].coefficients)
    intrinsic = {"size": (C, 2), "matrix": (C, 3, 3), "distortion": (C, coefficients)}
    return {**intrinsic, "T_cam_world": (C, 4, 4)}


def check_markers(model: Model, markers_world: Any) -> Array:
    """The model's markers (M, 3).

    Raises:
        TypeError: no real numbers.
        ValueError: another number of markers, or several samples at once.
    """
    shape = len(model.markers.bone_indices), 3
    return floating("markers_world", markers_world, shape, model.dtype, model)


def check_pose(name: str, model: Model, pose: Any, count: tuple[int, ...] = ()) -> Pose:
    """A pose of the model, or as many as ``count`` says.

    Raises:
        TypeError: no pose, or no real numbers.
        ValueError: of another skeleton, or several at once.
    """
    shapes = {"position": 3, "quaternion": 4, "angles": len(model.skeleton.tree.joints)}
    each = {part: (*count, size) for part, size in shapes.items()}
    return checked_parts(name, pose, Pose, each, model.dtype, model)


def check_measurements(name: str, model: Model, measured: Any, count: int) -> Measurements:
    """What was measured of so many events.

    Raises:
        TypeError: no ``Measurements``, or no real numbers.
        ValueError: one of ``NEEDED`` is missing, or has another shape.
    """
    check_kind(name, measured, Measurements)
    if missing := [part for part in NEEDED if getattr(measured, part) is None]:
        raise ValueError(f"{name}.{missing[0]} is missing, expected {', '.join(NEEDED)}")
    shapes = {"markers": (len(model.markers.bone_indices), 3), "upright": (2,), "facing": (3,)}
    shapes |= {"ankles": (2, 3), "elbows": (2, 3)}
    for part, value in measured._asdict().items():
        if part in shapes and value is not None:
            own = floating(f"{name}.{part}", value, (count, *shapes[part]), model.dtype, model)
            measured = measured._replace(**{part: own})
            continue
        for leaf in jax.tree.leaves(value):
            check_shape(f"{name}.{part}", np.shape(leaf)[:1], (count,), "one row for each event")
    return measured
