"""Where a recording's markers sit, and the body with the joints that they determine.

INPUTS: [markers], [markers.on], the labels of the marker file. OUTPUTS: PlacedMarkers.
"""

from collections.abc import Sequence
from typing import NamedTuple

from jaxmocap.body.model_files import MARKED, joint_rows
from jaxmocap.body.skeleton import Skeleton, with_added_joints
from jaxmocap.formats.files.toml import TomlTable
from jaxmocap.formats.marker_sets.marked_joints import with_marked_joints
from jaxmocap.formats.marker_sets.sets import MarkerSet, read_set
from jaxmocap.formats.recordings.marker_places import MarkerPlace, read_place


class PlacedMarkers(NamedTuple):
    """Where markers sit, on a body with the joints that they determine; the set, or None."""

    skeleton: Skeleton
    places: tuple[MarkerPlace, ...]
    marker_set: MarkerSet | None


def placed_markers(
    fields: TomlTable, on: TomlTable, labels: Sequence[str], skeleton: Skeleton
) -> PlacedMarkers:
    """The places that a set and [markers.on] state.

    A full set determines more than the 21 joints, and those serve more of its markers.
    """

    def on_body(body: Skeleton) -> PlacedMarkers:
        marker_set = read_set(fields, labels, body)
        entries = {**(marker_set.entries if marker_set else {}), **on.entries}
        places = (read_place(fields.path, name, entry) for name, entry in entries.items())
        return PlacedMarkers(body, tuple(places), marker_set)

    full = on_body(with_added_joints(skeleton, joint_rows(MARKED)))
    if not {place.bone for place in full.places} <= set(skeleton.tree.bones):
        return on_body(skeleton)
    return on_body(with_marked_joints(skeleton, full.places))
