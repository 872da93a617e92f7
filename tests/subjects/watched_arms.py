"""Arms before drawn pictures, as the refinement takes them: shared by its tests."""

import jax
import jax.numpy as jnp
import numpy as np
from conftest import on_device
from drawn_arms import arm_pose, camera_at, draw, limbs_of

from jaxmocap.body.arms import arm_dofs, arms_of, hang, swing
from jaxmocap.body.kinematics import forward, landmark_sites
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.evidence.edges import EdgeFields
from jaxmocap.geometry.rotations import about_axis, compose, rotate
from jaxmocap.hybrid.observe import arm_regions, edge_fields, no_thresholds
from jaxmocap.hybrid.settings import Settings

SIZE = 96
# Left: the forearm across the belly, outlined from the front; right: raised to the side.
DEGREES = {
    "arm_flex": (15, 20),
    "arm_abduct": (40, 50),
    "arm_rot": (60, -30),
    "elbow_flex": (80, 75),
}
PERSON = Skeleton.human(1.75, proportions="winter")
TRUTH = arm_pose(PERSON, DEGREES)
FRONT = camera_at((2.2, 0.3, 1.35), (0.0, 0.0, 1.15))
SIDE = camera_at((0.7, -2.2, 1.4), (0.0, 0.0, 1.15))
MARKERS = landmark_sites(PERSON, ("vertex", "wrist_l", "wrist_r"))
# Without cameras: most tests have cameras of their own.
MODEL = Model.create(PERSON, MARKERS)
GRIPS = MODEL.grips
DOFS = arm_dofs(PERSON.tree)


def stacked(*cameras):
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *cameras)


@jax.jit
def arms_in(pose):
    """Both arms of a pose."""
    return arms_of(PERSON, forward(PERSON, pose), GRIPS)


@jax.jit
def swivelled(arms, angles):
    """Both arms turned by (2,) angles, radians, about the axis from shoulder to grip."""
    axis = arms.grip - arms.shoulder
    R = about_axis(axis / jnp.linalg.norm(axis, axis=-1, keepdims=True), angles)

    def moved(points):
        return arms.shoulder + rotate(R, points - arms.shoulder)

    return arms._replace(
        elbow=moved(arms.elbow),
        wrist=moved(arms.wrist),
        tip=moved(arms.tip),
        R_world_radius=compose(R, arms.R_world_radius),
    )


def true_arms():
    return arms_in(on_device(TRUTH))


def turned_by(left, right):
    """The true arms, elbows swivelled away."""
    return swivelled(true_arms(), jnp.array([left, right], jnp.float32))


@jax.jit
def swung(pose, moves):
    """Arms of a pose, bent and swung, and their joint angles."""
    return swing(hang(PERSON, pose, GRIPS), moves)


def pose_off_by(left: float, right: float) -> Pose:
    """The true pose, its elbows swivelled away by joint angles."""
    moves = jnp.zeros((2, 4)).at[:, 0].set(jnp.array([left, right], jnp.float32))
    start = on_device(TRUTH)
    return start._replace(angles=start.angles.at[DOFS].set(swung(start, moves)[1]))


def elbow_errors(elbows) -> np.ndarray:
    """Distances (2,) of elbows from the truth, metres."""
    return np.linalg.norm(np.asarray(elbows) - np.asarray(true_arms().elbow), axis=-1)


def pictures(*cameras) -> list[np.ndarray]:
    """What each camera sees of the true arms."""
    limbs = list(limbs_of(PERSON, TRUTH))
    return [draw(camera, limbs) for camera in cameras]


def picture_of(arms) -> np.ndarray:
    """What the front camera sees of other arms."""
    ends = [np.asarray(part, float) for part in (arms.shoulder, arms.elbow, arms.wrist, arms.tip)]
    radii = np.asarray(arms.radii, float)
    limbs = [(ends[i][arm], ends[i + 1][arm], radii[arm, i]) for arm in range(2) for i in range(3)]
    return draw(FRONT, limbs)


@jax.jit
def _regions(settings, cameras, arms):
    return arm_regions(cameras, arms, settings.samples, settings.margin, settings.spacing)


def observed(images, cameras, arms, settings: Settings | None = None) -> EdgeFields:
    """The fields of first images, in the regions where ``arms`` are."""
    settings = settings or Settings(region=SIZE)
    regions = _regions(settings, cameras, arms)
    return edge_fields(settings, no_thresholds(len(images)), images, regions)[0]
