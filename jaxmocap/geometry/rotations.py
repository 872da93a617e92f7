"""SO(3): exponential, logarithm, quaternions and products of hinges.

INPUTS: rotation vectors, quaternions (wxyz), axes and angles, any leading batch shape.
OUTPUTS: the same rotation in another form; exact and differentiable at 0 and at pi.

Products, ``exp`` and ``quaternion_from_matrix`` work alike with JAX and, on the host, with NumPy.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.compilation.arrays import Numbers, namespace

# Products of rotations run at full float32: a GPU's TF32 would cost millimetres at the hand.
HIGHEST = jax.lax.Precision.HIGHEST
# Angles keep to their limits where they are beyond them by less, radians in all.
BEYOND_RAD = 0.1


def compose(R_a_b: Numbers, R_b_c: Numbers) -> Numbers:
    """Matrix product ``R_a_c`` of two (..., 3, 3) rotations, at full precision.

    Of (..., 4, 4) rigid transforms as well.

    Written out: of matrices this small a call to a product's routine costs more than the product,
    and what is written out melts into what is around it.
    """
    parts = (slice(i, i + 1) for i in range(R_a_b.shape[-1]))
    first, *others = (R_a_b[..., part] * R_b_c[..., part, :] for part in parts)
    return sum(others, start=first)


def rotate(R_a_b: Numbers, vectors_b: Numbers) -> Numbers:
    """Turn (..., 3) vectors from frame b into frame a, at full precision."""
    return compose(R_a_b, vectors_b[..., None])[..., 0]


def cross(a: Array | np.ndarray, b: Array) -> Array:
    """Cross products (..., 3) of (..., 3) vectors, in half of the equations of ``jnp.cross``."""
    (ax, ay, az), (bx, by, bz) = ([v[..., i : i + 1] for i in range(3)] for v in (a, b))
    return jnp.concatenate([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], -1)


def hat(vectors: Numbers) -> Numbers:
    """Cross-product matrices (..., 3, 3) of (..., 3) vectors: ``hat(a) @ b == cross(a, b)``."""
    x, y, z = (vectors[..., i : i + 1] for i in range(3))
    xp, o = namespace(x), 0 * x
    rows = xp.concatenate([o, -z, y, z, o, -x, -y, x, o], -1)
    return rows.reshape(*vectors.shape, 3)


def about_axis(axes: Array, angles: Array) -> Array:
    """Rotations (..., 3, 3) by ``angles`` (...), radians, about unit ``axes`` (..., 3)."""
    s, c = jnp.sin(angles)[..., None, None], jnp.cos(angles)[..., None, None]
    outer = axes[..., :, None] * axes[..., None, :]
    return c * np.eye(3, dtype=axes.dtype) + s * hat(axes) + (1 - c) * outer


def exp(rotation_vectors: Numbers) -> Numbers:
    """Rodrigues' formula: (..., 3) rotation vectors, radians, to (..., 3, 3) matrices."""
    xp, squared = namespace(rotation_vectors), (rotation_vectors**2).sum(-1)
    small = squared < 1e-8
    angle = xp.sqrt(xp.where(small, 1.0, squared))
    a = xp.where(small, 1 - squared / 6, xp.sin(angle) / angle)
    b = xp.where(small, 0.5 - squared / 24, (1 - xp.cos(angle)) / angle**2)
    K = hat(rotation_vectors)
    K2 = compose(K, K)
    return np.eye(3, dtype=K.dtype) + a[..., None, None] * K + b[..., None, None] * K2


def quaternion_exp(rotation_vectors: Array) -> Array:
    """(..., 3) rotation vectors, radians, to (..., 4) unit quaternions, wxyz."""
    squared = jnp.sum(rotation_vectors**2, -1, keepdims=True)
    small = squared < 1e-8
    angle = jnp.sqrt(jnp.where(small, 1.0, squared))
    w = jnp.where(small, 1 - squared / 8, jnp.cos(angle / 2))
    scale = jnp.where(small, 0.5 - squared / 48, jnp.sin(angle / 2) / angle)
    return jnp.concatenate([w, scale * rotation_vectors], -1)


def quaternion_log(quaternions: Array) -> Array:
    """(..., 4) unit quaternions, wxyz, to the shorter of their (..., 3) rotation vectors."""
    sign = jnp.where(quaternions[..., :1] < 0, -1.0, 1.0).astype(quaternions.dtype)
    w, xyz = sign * quaternions[..., :1], sign * quaternions[..., 1:]
    squared = jnp.sum(xyz**2, -1, keepdims=True)
    small = squared < 1e-8
    norm = jnp.sqrt(jnp.where(small, 1.0, squared))
    factor = jnp.where(small, 2 / jnp.maximum(w, 0.5), 2 * jnp.arctan2(norm, w) / norm)
    return factor * xyz


def quaternion_multiply(a: Array, b: Array) -> Array:
    """Hamilton product of (..., 4) quaternions, wxyz."""
    aw, av, bw, bv = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    w = aw * bw - jnp.sum(av * bv, -1, keepdims=True)
    return jnp.concatenate([w, aw * bv + bw * av + cross(av, bv)], -1)


def quaternion_to_matrix(quaternions: Array) -> Array:
    """(..., 4) quaternions, wxyz (normalised here), to (..., 3, 3) matrices."""
    q = quaternions / jnp.linalg.norm(quaternions, axis=-1, keepdims=True)
    w, K = q[..., 0, None, None], hat(q[..., 1:])
    return np.eye(3, dtype=q.dtype) + 2 * w * K + 2 * compose(K, K)


def quaternion_from_matrix(R: Numbers) -> Numbers:
    """(..., 3, 3) rotations to (..., 4) quaternions, wxyz, w >= 0.

    Of the four ways to divide, the one with the largest pivot is taken, so that neither the
    values nor the derivatives degrade at half turns.
    """
    xp, d = namespace(R), R.diagonal(axis1=-2, axis2=-1)
    x, y, z = d[..., 0], d[..., 1], d[..., 2]
    a, b, c = R[..., 2, 1], R[..., 0, 2], R[..., 1, 0]
    e, f, g = R[..., 1, 2], R[..., 2, 0], R[..., 0, 1]
    rows = xp.stack(
        [
            xp.stack([1 + x + y + z, a - e, b - f, c - g], -1),
            xp.stack([a - e, 1 + x - y - z, c + g, b + f], -1),
            xp.stack([b - f, c + g, 1 - x + y - z, a + e], -1),
            xp.stack([c - g, b + f, a + e, 1 - x - y + z], -1),
        ],
        -2,
    )
    pivot = rows.diagonal(axis1=-2, axis2=-1).argmax(-1)
    row = xp.take_along_axis(rows, pivot[..., None, None], -2)[..., 0, :]
    q = row / xp.linalg.norm(row, axis=-1, keepdims=True)
    return xp.where(q[..., :1] < 0, -q, q)


def log(R: Array) -> Array:
    """(..., 3, 3) rotations to (..., 3) rotation vectors, radians, of length at most pi."""
    return quaternion_log(quaternion_from_matrix(R))


def hinges_from_matrix(R: Array, axes: Array) -> Array:
    """Angles (3,) with ``R = H1 H2 H3``, where ``Hi`` turns about the unit rows of ``axes``.

    The rows are orthogonal, in either handedness (a left shoulder mirrors a right one). The
    second angle is in [-pi/2, pi/2]; where it is +-pi/2 (gimbal lock) the third is 0.
    """
    # In the basis of the axes a left-handed triple turns the other way about every axis.
    handed = jnp.dot(cross(axes[0], axes[1]), axes[2], precision=HIGHEST)
    M = compose(compose(axes, R), axes.T)
    cosine2 = M[0, 0] ** 2 + M[0, 1] ** 2
    locked = cosine2 < 1e-12
    cosine = jnp.where(locked, 0.0, jnp.sqrt(jnp.where(locked, 1.0, cosine2)))
    second = jnp.arctan2(M[0, 2], cosine)
    first = jnp.arctan2(jnp.where(locked, M[2, 1], -M[1, 2]), jnp.where(locked, M[1, 1], M[2, 2]))
    # Of what the first hinge leaves: near the lock, where rounding turns it freely, the third
    # turns back.
    s, c = jnp.sin(first), jnp.cos(first)
    third = jnp.arctan2(c * M[1, 0] + s * M[2, 0], c * M[1, 1] + s * M[2, 1])
    return handed * jnp.stack([first, second, third])


def nearest_hinges(R: Array, axes: Array, near: Array, limits: Array | None = None) -> Array:
    """Angles (3,) of the hinges that make up ``R``, of both answers the one nearer to ``near``.

    With limits (3, 2), where one answer keeps to them and the other does not, it is that one: an
    arm that is raised beyond the level has one within them and one far beyond.
    """
    one = hinges_from_matrix(R, axes)
    other = jnp.stack([one[0] + jnp.pi, jnp.pi - one[1], one[2] + jnp.pi])
    about = near if limits is None else jnp.mean(limits, -1)
    answers = about + (jnp.stack([one, other]) - about + jnp.pi) % (2 * jnp.pi) - jnp.pi
    away = jnp.sum((answers - near) ** 2, -1)
    is_first = away[0] <= away[1]
    if limits is not None:
        low, high = limits.T
        beyond = jnp.maximum(low - answers, 0.0) + jnp.maximum(answers - high, 0.0)
        within = jnp.sum(beyond, -1) < BEYOND_RAD
        is_first = jnp.where(within[0] == within[1], is_first, within[0])
    return jnp.where(is_first, answers[0], answers[1])
