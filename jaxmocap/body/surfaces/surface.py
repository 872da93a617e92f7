"""The body's surface: patches of a grid of nodes that bones carry (second paper, 3.1.5 and 3.2).

INPUTS: nodes in bones' frames with their shares; the frames of a pose.
OUTPUTS: nodes in the world; the same surface denser, or smoother; nodes (T, N, 3) over time, in
double precision on the host, for files and pictures.

A patch is a two-parametric surface F(phi1, phi2): phi1 runs around a limb and is periodic, phi2
along it. Every node's list of joints, in order, is the chain of the bones that carry it. Nothing
here depends on where the nodes come from: ``loft``, or from scans of a person.
"""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Frames
from jaxmocap.body.orientations import body_turns, matrices
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.subject import bone_vectors
from jaxmocap.compilation.arrays import on_device
from jaxmocap.geometry.fourier import cosine_matrix, fourier_matrix, linear_matrix
from jaxmocap.geometry.rotations import HIGHEST, rotate


class BodyPoints(NamedTuple):
    """N points that up to K bones carry, as skin does over a joint; indices may be traced."""

    bones: Array | np.ndarray  # (N, K) int32 indices
    # (N, K, 3) the point in each bone's frame, from its joint, metres.
    points_bone: Array | np.ndarray
    shares: Array | np.ndarray  # (N, K) of each bone, together 1


@dataclass(frozen=True)
class Patch:
    """A grid of nodes: ``along`` rings of ``around`` nodes, from the near end to the far."""

    name: str  # of the limb, and of its side: ``arm_l``
    around: int  # nodes of a ring
    along: int  # rings
    # Index of its first node in the surface; node (ring v, place u) is ``start + v * around + u``.
    start: int

    @property
    def limb(self) -> str:
        """The name without the side."""
        return self.name.partition("_")[0]

    @property
    def side(self) -> str:
        """``l`` or ``r``; "" in the middle."""
        return self.name.partition("_")[2]

    @property
    def outwards(self) -> int:
        """Where 90 degrees around it lie: 1 to the left, -1 to the right."""
        return -1 if self.side == "r" else 1

    @property
    def continued(self) -> str:
        """Name of the patch whose limb it belongs to: a foot continues its leg."""
        return self.name.replace("foot", "leg")

    @property
    def nodes(self) -> slice:
        """Its nodes in the surface."""
        return slice(self.start, self.start + self.around * self.along)

    def grid(self, nodes: np.ndarray) -> np.ndarray:
        """(along, around, 3) its own of the surface's nodes (N, 3), ring by ring: a view."""
        return nodes[self.nodes].reshape(self.along, self.around, 3)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Surface:
    """A body's surface of N nodes."""

    # In the order of their nodes (static).
    patches: tuple[Patch, ...] = field(metadata={"static": True})
    points: BodyPoints  # the nodes on their bones

    def patch_of(self) -> np.ndarray:
        """(N,) index of every node's patch."""
        sizes = [patch.around * patch.along for patch in self.patches]
        return np.repeat(np.arange(len(sizes), dtype=np.int32), sizes)


def pose_points(frames: Frames, points: BodyPoints) -> Array:
    """Points (N, 3) in the world, metres: linear blend skinning."""
    return jnp.sum(jnp.asarray(points.shares)[..., None] * carry_by_bones(frames, points), -2)


def carry_by_bones(frames: Frames, points: BodyPoints) -> Array:
    """(N, K, 3) where each bone alone would carry its points."""
    R, joints = frames.R_world_bone[points.bones], frames.joints_world[points.bones]
    return joints + rotate(R, jnp.asarray(points.points_bone))


def surface_from_rest(
    grids: dict[str, np.ndarray], shares: dict[str, np.ndarray], joints: np.ndarray
) -> Surface:
    """A surface from nodes in the pose of all angles 0, where bones' frames are the world's.

    Args:
        grids: patch -> (along, around, 3) nodes, metres.
        shares: patch -> (along, around, B) of every bone; the two largest are kept.
        joints: (B, 3) of the bones at rest, metres.
    """
    patches, start = [], 0
    for name, grid in grids.items():
        patches.append(Patch(name, grid.shape[1], grid.shape[0], start))
        start += grid.shape[0] * grid.shape[1]
    nodes = np.concatenate([grid.reshape(-1, 3) for grid in grids.values()])
    weights = np.concatenate([shares[name].reshape(-1, len(joints)) for name in grids])
    bones = np.argsort(-weights, 1, kind="stable")[:, :2].astype(np.int32)
    kept = np.take_along_axis(weights, bones, 1)
    kept = kept / kept.sum(1, keepdims=True)
    places = nodes[:, None] - joints[bones]
    points = BodyPoints(bones, on_device(places), on_device(kept))
    return Surface(tuple(patches), points)


def every_share(points: BodyPoints, bones: int) -> np.ndarray:
    """(N, B) the share of every bone at N points."""
    shares = np.zeros((len(points.bones), bones))
    np.put_along_axis(shares, np.asarray(points.bones), np.asarray(points.shares), 1)
    return shares


def rest_nodes(surface: Surface, joints: np.ndarray) -> np.ndarray:
    """Nodes (N, 3) with all angles 0, metres, given the bones' joints (B, 3) there."""
    carried_at = joints[np.asarray(surface.points.bones)] + np.asarray(surface.points.points_bone)
    return np.sum(np.asarray(surface.points.shares)[..., None] * carried_at, 1)


def resample_surface(surface: Surface, joints: np.ndarray, spacing: float) -> Surface:
    """The same surface with nodes about ``spacing`` metres apart: for its index image.

    Around, by the Fourier series of (3.17), evaluated at more places; along, linearly.
    """
    nodes, full = rest_nodes(surface, joints), every_share(surface.points, len(joints))
    grids, shares = {}, {}
    for patch in surface.patches:
        grid = patch.grid(nodes)
        rows = full[patch.nodes].reshape(patch.along, patch.around, -1)
        around, along = _places(grid, spacing)
        grids[patch.name] = _denser(patch, grid, around, along)
        onto = linear_matrix(patch.along, along)
        turn = linear_matrix(patch.around, around, periodic=True)
        shares[patch.name] = np.einsum("av,vuc,bu->abc", onto, rows, turn, optimize=True)
    return surface_from_rest(grids, shares, joints)


def resample_moves(
    surface: Surface, joints: np.ndarray, spacing: float, moves: np.ndarray
) -> np.ndarray:
    """Moves (M, 3) of the nodes of ``resample_surface`` by those of a surface's own, (N, 3)."""
    nodes, rows = rest_nodes(surface, joints), []
    for patch in surface.patches:
        places = _places(patch.grid(nodes), spacing)
        rows.append(_denser(patch, patch.grid(moves), *places).reshape(-1, 3))
    return np.concatenate(rows)


def _denser(patch: Patch, grid: np.ndarray, around: np.ndarray, along: np.ndarray) -> np.ndarray:
    """A patch's grid (along, around, 3), or moves of it, at more places."""
    across, onto = fourier_matrix(patch.around, around), linear_matrix(patch.along, along)
    return np.einsum("av,vuc,bu->abc", onto, grid, across, optimize=True)


def _places(grid: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Places around (on average) and along (at most) ``spacing`` apart, in nodes of a grid."""
    girth = np.linalg.norm(np.roll(grid, -1, 1) - grid, axis=-1).sum(1).max()
    # At least as many as there were: a series cut short would be another surface.
    around = max(int(np.ceil(girth / spacing)), grid.shape[1])
    gaps = np.linalg.norm(np.diff(grid, axis=0), axis=-1).max(1)
    steps = [
        ring + np.arange(count) / count
        for ring, count in enumerate(np.maximum(np.ceil(gaps / spacing), 1).astype(int))
    ]
    along = np.append(np.concatenate(steps), grid.shape[0] - 1.0)
    return np.arange(around) * grid.shape[1] / around, along


def low_pass(surface: Surface, joints: np.ndarray, harmonics: int, along: int) -> Surface:
    """The surface with the lowest frequencies of (3.18) only: coarse, for a pose far off.

    Around, the lowest ``harmonics`` of the periodic transform; along the limb, which has ends and
    no period, the lowest ``along`` of the cosine transform, its mirrored continuation's series.
    """
    nodes, bones = rest_nodes(surface, joints), np.asarray(surface.points.bones)
    for patch in surface.patches:
        grid = patch.grid(nodes)
        across = fourier_matrix(patch.around, np.arange(patch.around), harmonics)
        onto = cosine_matrix(patch.along, along)
        smooth = np.einsum("av,vuc,bu->abc", onto, grid, across, optimize=True)
        nodes[patch.nodes] = smooth.reshape(-1, 3)
    places = on_device(nodes[:, None] - joints[bones])
    return replace(surface, points=surface.points._replace(points_bone=places))


class Skin(NamedTuple):
    """A surface as one product: of many nodes ten times as fast as ``pose_points``."""

    weights: Array  # (B, N) share of every bone
    rest: Array  # (3, N) nodes with all angles 0, from the pelvis, metres
    joints: Array  # (B, 3) of the bones there


def skin_of(surface: Surface, joints: np.ndarray) -> Skin:
    """A surface around bones with these joints (B, 3) at rest, for ``skin_nodes``."""
    dtype = jnp.asarray(surface.points.points_bone).dtype
    weights, rest = every_share(surface.points, len(joints)), rest_nodes(surface, joints)
    return Skin(*(on_device(part, dtype) for part in (weights.T, rest.T, joints)))


def skin_nodes(frames: Frames, skin: Skin) -> tuple[Array, Array, Array]:
    """Nodes in the world by components, each (N,), metres; arrays of three are slow to go through.

    Every node is moved by its bones' blended transform.
    """
    R = frames.R_world_bone
    shifts = frames.joints_world - rotate(R, skin.joints)
    transforms = jnp.concatenate([R, shifts[..., None]], -1).reshape(len(shifts), 12)
    T = jnp.matmul(transforms.T, skin.weights, precision=HIGHEST)
    x, y, z = skin.rest
    rows = [T[i] * x + T[i + 1] * y + T[i + 2] * z + T[i + 3] for i in (0, 4, 8)]
    return rows[0], rows[1], rows[2]


def bones_over_time(skeleton: Skeleton, poses: Pose) -> tuple[np.ndarray, np.ndarray]:
    """Orientations (T, B, 3, 3) of the bones and places (T, B, 3) of their joints, world."""
    root = matrices(np.asarray(poses.quaternion, float))
    R = root[:, None] @ body_turns(skeleton, np.asarray(poses.angles, float))
    reach = bone_vectors(skeleton)
    joints = np.repeat(np.asarray(poses.position, float)[:, None], len(reach), 1)
    for bone, parent in enumerate(skeleton.tree.parents):
        if parent >= 0:
            joints[:, bone] = joints[:, parent] + R[:, parent] @ reach[parent]
    return R, joints


def nodes_over_time(
    points: BodyPoints, R_world_bone: np.ndarray, joints_world: np.ndarray
) -> np.ndarray:
    """Nodes (T, N, 3) of ``bones_over_time``'s bones: linear blend skinning."""
    bones, shares = np.asarray(points.bones), np.asarray(points.shares, float)
    places = np.asarray(points.points_bone, float)
    nodes = np.zeros((len(joints_world), len(bones), 3))
    for k in range(bones.shape[1]):
        turned = np.einsum("tnij,nj->tni", R_world_bone[:, bones[:, k]], places[:, k])
        nodes += shares[:, k, None] * (joints_world[:, bones[:, k]] + turned)
    return nodes
