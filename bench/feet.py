"""``python -m bench.feet RECORDINGS``: feet on the ground, as in the second paper's Fig. 32.

Rendered people touch the floor, z = 0, with their lowest point. A foot stands while the truth's toe
is within a centimetre of its lowest place. Then: how high the lowest node of the tracked foot's
skin is over the floor, how far toe and ankle are above or below the truth's, and how far the toe
slides against the truth's, in a second and from a step's first frame to its last.

INPUTS: the folder of people as rigged meshes. OUTPUTS: a table, and Metrics.
"""

from pathlib import Path

import numpy as np

from bench import add_rendered, command, kept
from bench.clips import Clip, exercises
from bench.figures import Metric, write_json
from bench.silhouette import prepared
from jaxmocap.body.surfaces.surface import bones_over_time, nodes_over_time
from jaxmocap.evaluation.series import match
from jaxmocap.evaluation.tables import align_columns
from jaxmocap.formats.time_series.trc import read_trc
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.pipelines.silhouettes.track import track_silhouettes
from jaxmocap.silhouette.settings import Settings

STANDING_M = 0.01
# Of a step, frames.
SHORTEST = 3
FIGURES = {
    "sole over the floor, mean": "cm",
    "sole, RMS": "cm",
    "toe's height off, RMS": "cm",
    "ankle's height off, RMS": "cm",
    "toe slides": "cm/s",
    "over a step": "cm",
}


def measured(clip: Clip, cameras: int) -> list[float]:
    """The figures, of both feet together."""
    settings, truth = Settings(), read_trc(clip.truth)
    recording, start = prepared(clip, cameras, settings)
    result = track_silhouettes(recording, start, settings, progress=True)
    ours, theirs = match(result.motion.times, truth.times)
    turns, places = bones_over_time(result.motion.skeleton, result.motion.poses)
    nodes = nodes_over_time(result.surface.points, turns, places)[ours]
    joints, times, parts = result.motion.joints(), truth.times[theirs], []
    for patch in result.surface.patches:
        if patch.limb != "foot":
            continue
        true, found = (
            [each[f"{part}_{patch.side}"][rows] for part in ("toe", "ankle")]
            for each, rows in ((truth.points(), theirs), (joints, ours))
        )
        stands = true[0][:, 2] < true[0][:, 2].min() + STANDING_M
        off = np.array(found) - true
        sole = nodes[:, patch.nodes, 2].min(1)
        pairs = stands[1:] & stands[:-1]
        slides = np.linalg.norm(np.diff(off[0, :, :2], axis=0), axis=1) / np.diff(times)
        runs = np.split(np.arange(len(stands)), np.flatnonzero(~pairs) + 1)
        steps = [np.linalg.norm(off[0, run[-1], :2] - off[0, run[0], :2]) for run in runs
                 if len(run) >= SHORTEST]  # fmt: skip
        parts.append((sole[stands], off[0, stands, 2], off[1, stands, 2], slides[pairs], steps))
    sole, toe, ankle, slides, steps = (
        100 * np.concatenate(each) for each in zip(*parts, strict=True)
    )
    squares = (float(np.sqrt(np.mean(each**2))) for each in (sole, toe, ankle))
    return [float(np.mean(sole)), *squares, float(np.mean(slides)), float(np.mean(steps))]


def main() -> None:
    """Render, track, compare, print."""
    parser = command("bench.feet", __doc__)
    parser.add_argument("recordings", help="folder of the rigged meshes")
    parser.add_argument("--only", default="walking", metavar="NAME,...", help="default: walking")
    parser.add_argument("--cameras", type=int, default=4, help="how many; default: 4")
    add_rendered(parser)
    options = parser.parse_args()
    keep_compiled()
    file, cells, metrics = Path(options.recordings) / "person" / "person.npz", [], []
    with kept(options.keep) as keep:
        people = options.people.split(",")
        names = options.only.split(",")
        clips = exercises(file, names, options.seeds, people, options.seconds, keep)
        for clip in clips:
            figures = measured(clip, options.cameras)
            cells.append([clip.name, *(f"{value:.2f}" for value in figures)])
            metrics += [
                Metric(f"feet, {clip.name}, {name}", abs(value), unit)
                for (name, unit), value in zip(FIGURES.items(), figures, strict=True)
            ]
    print(align_columns([["", *(f"{name}, {unit}" for name, unit in FIGURES.items())], *cells]))
    write_json(metrics, options.json)


if __name__ == "__main__":
    main()
