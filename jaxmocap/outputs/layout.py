"""The layout of a recording in the rerun viewer: the blueprint.

INPUTS: names of cameras and of their fields, a BodyScene. OUTPUTS: a blueprint.
"""

from collections.abc import Mapping

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from jaxmocap.outputs.scene import BodyScene, Floor

TIMELINE = "time"
# Root entities of time series that several recorders log.
ANGLES, DEVIATIONS = "joint_angles", "elbow_deviations"
# Root entity of the text on what determines each landmark.
WHY = "why"
# Entity -> title of its view; the first two are shown at once.
SERIES = {
    ANGLES: "Joint angles [°]",
    DEVIATIONS: "Elbows [± cm]",
    "marker_errors": "Marker errors [mm]",
    "arm_costs": "Arm costs [px]",
    "swivel": "Swivel by video [°]",
    "milliseconds": "Stage times [ms]",
}


# RGB behind the body, and of the floor's grid with its opacity.
BACKGROUND, GRID_COLOUR = (222, 227, 233), (120, 130, 142, 110)
# Metres between the grid's lines, and their width in points of the screen.
GRID_M, GRID_WIDTH = 0.5, 0.8


def lay_out(
    cameras: Mapping[str, list[str]],
    scene: BodyScene,
    floor: Floor | None = None,
    series: Mapping[str, str] = SERIES,
    live: bool = False,
    why: bool = False,
) -> rrb.Blueprint:
    """Body to the left, all cameras to the right, two time series below; the rest behind tabs.

    A recording plays from its first frame, again and again; a live run is followed. Cameras have
    the names of their fields, series those of their views.
    """
    body = rrb.Spatial3DView(
        origin="/world",
        name="Body",
        eye_controls=_eye(scene),
        background=rrb.Background(color=BACKGROUND, kind=rrb.BackgroundKind.SolidColor),
        line_grid=rrb.LineGrid3D(
            floor is not None,
            spacing=GRID_M,
            plane=rr.components.Plane3D((0.0, 0.0, 1.0), floor.height_m if floor else 0.0),
            stroke_width=GRID_WIDTH,
            color=GRID_COLOUR,
        ),
        # Within the body; who hides that by the viewer's list of entities may show it.
        overrides={"world/skeleton": rrb.EntityBehavior(visible=False)},
    )
    top: list[rrb.View | rrb.Container] = [body]
    if cameras:
        top.append(_camera_views(cameras))
    legend = rrb.PlotLegend(rrb.Corner2D.LeftTop)
    curves = [
        rrb.TimeSeriesView(origin=f"/{entity}", name=title, plot_legend=legend)
        for entity, title in series.items()
    ]
    texts: list[rrb.View] = [rrb.TextLogView(origin="/statuses", name="Statuses")]
    if why:
        texts.append(rrb.TextDocumentView(origin=f"/{WHY}", name="Why [± cm]"))
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(*top),
            rrb.Horizontal(*curves[:2], rrb.Tabs(*texts, *curves[2:]), column_shares=[3, 3, 2]),
            row_shares=[5, 2],
        ),
        rrb.TimePanel(
            timeline=TIMELINE,
            state="collapsed",
            play_state="following" if live else "playing",
            loop_mode=None if live else "all",
        ),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def _camera_views(cameras: Mapping[str, list[str]]) -> rrb.Container:
    """All cameras' images; behind a tab their fields, where there are any."""
    images = rrb.Grid(
        *(
            rrb.Spatial2DView(origin=entity_path("world", "cameras", name), name=name)
            for name in cameras
        ),
        name="Images",
    )
    tabs = []
    for name, labels in cameras.items():
        fields = [
            rrb.Spatial2DView(origin=entity_path("fields", name, label), name=f"{name}: {label}")
            for label in labels
        ]
        if fields:
            tabs.append(rrb.Horizontal(*fields, name=f"{name}: edges"))
    return rrb.Tabs(images, *tabs) if tabs else images


def _eye(scene: BodyScene) -> rrb.EyeControls3D | None:
    """Far enough ahead of the first known pose to see the whole body."""
    known = np.flatnonzero(np.isfinite(scene.near).all((1, 2)))
    if not len(known):
        return None
    near, R_world_bone = scene.near[known[0]], scene.R_world_bone[known[0]]
    centre = (near.min(0) + near.max(0)) / 2
    size = float(np.linalg.norm(np.ptp(near, axis=0)))
    ahead, left = R_world_bone[0, :, 0], R_world_bone[0, :, 1]
    away = ahead + 0.5 * left + np.array([0.0, 0.0, 0.35])
    position = centre + 1.3 * size * away
    return rrb.EyeControls3D(position=position, look_target=centre, eye_up=(0.0, 0.0, 1.0))


def entity_path(*parts: str) -> str:
    """An entity path whose parts may hold any character."""
    return rr.new_entity_path(list(parts))
