"""The tracked person's key points in a video as lines of sight.

INPUTS: a skeleton, a camera, one person's Detections. OUTPUTS: SightLines.
"""

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.evidence.keypoints import SightLines, estimated_depths, lines_of_sight
from jaxmocap.formats.recordings.keypoints import Detections
from jaxmocap.geometry.cameras import Camera


def lines_to_person(skeleton: Skeleton, camera: Camera, person: Detections) -> SightLines:
    """The lines (F, 1, ...) to the only person of F frames, with depths where there are joints."""
    joints, depths = person.joints_cam, None
    if joints is not None:
        depths = estimated_depths(skeleton, person.landmarks, joints[:, 0])
    pixels_xy, sure = person.pixels_xy[:, 0], person.confidences[:, 0]
    return lines_of_sight(camera, person.landmarks, pixels_xy, sure, depths)
