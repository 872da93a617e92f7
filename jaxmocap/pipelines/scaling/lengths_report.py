"""The bone lengths that a recording determines: as text, figures and a picture.

INPUTS: a body before and after, the fit of its lengths. OUTPUTS: text, figures, a picture file.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from jaxmocap.body.proportions import GIRTHS, LENGTHS
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.calibration.fitting.lengths import LengthsFit
from jaxmocap.evaluation.plots import new_panels, save_figure

# A length is determined where its standard deviation given the recording is at most this share of
# that among people of the stated body.
DETERMINED_SHARE = 0.5
# The same of a length that is partly determined.
PARTLY_SHARE = 0.7
DETERMINED = "determined"
PARTLY_DETERMINED = "partly determined"
NOT_DETERMINED = "not determined by this recording"
# Verdict -> colour in the picture, from the best to the worst.
COLOURS = {DETERMINED: "#1557b0", PARTLY_DETERMINED: "#ef8e19", NOT_DETERMINED: "#9e9e9e"}
RULE = (
    "Of one side each, breadths from the middle; ± is one standard deviation.",
    f"Determined: ± is at most {DETERMINED_SHARE:.0%} of what it was before; partly: at most "
    f"{PARTLY_SHARE:.0%};",
    "otherwise the recording adds little to the length as stated.",
)


def verdict_of(before: float, after: float) -> str:
    """Whether a recording determines a length, by the deviations before and after it."""
    share = after / before
    if share <= DETERMINED_SHARE:
        return DETERMINED
    return PARTLY_DETERMINED if share <= PARTLY_SHARE else NOT_DETERMINED


@dataclass(frozen=True)
class LengthEstimate:
    """One length as it was estimated."""

    name: str  # of the proportion
    bones: tuple[str, ...]  # that it is the length of, in sum, those of one side
    length_m: float  # as estimated, metres
    stated_m: float  # as stated, metres
    deviation_before: float  # standard deviation among people, a share of the length
    deviation_after: float  # the same given the recording

    @property
    def verdict(self) -> str:
        """Whether the recording determines it."""
        return verdict_of(self.deviation_before, self.deviation_after)

    @property
    def change(self) -> float:
        """Against the length as stated: 0 is none, 0.01 one percent."""
        return self.length_m / self.stated_m - 1

    @property
    def line(self) -> str:
        """All of it as a line of text."""
        return (
            f"{self.name.ljust(16)} {self.length_m:.4f} m ({self.change:+.1%})  "
            f"± {self.deviation_after:.1%}, before ± {self.deviation_before:.1%}  {self.verdict}"
        )


@dataclass(frozen=True)
class LengthsReport:
    """A person's lengths from a recording."""

    skeleton: Skeleton
    height: float  # as stated, metres
    lengths: tuple[LengthEstimate, ...]  # in the order of ``LENGTHS``
    girths: dict[str, float]  # name -> factor, clothes included; not in the file
    correlation: np.ndarray  # (L, L) between the lengths' errors
    path: Path  # of the body's file

    @classmethod
    def of(
        cls, stated: Skeleton, person: Skeleton, height: float, fit: LengthsFit, path: Path
    ) -> "LengthsReport":
        """Of a body as stated, as estimated, and the fit that changed it."""
        lengths = []
        for row, proportion in enumerate(LENGTHS):
            named = stated.tree.names_in
            bones = named(*proportion.bones, side="l") or named(*proportion.bones)
            rows = [stated.tree.bone(bone) for bone in bones]
            before, after = (float(sum(body.lengths[i] for i in rows)) for body in (stated, person))
            deviations = float(fit.before[row]), float(fit.after[row])
            lengths.append(LengthEstimate(proportion.name, bones, after, before, *deviations))
        count = len(LENGTHS)
        spread = fit.after[:count]
        correlation = fit.covariance[:count, :count] / np.outer(spread, spread)
        factors = np.exp(fit.logarithms[count:]).tolist()
        girths = {girth.name: factor for girth, factor in zip(GIRTHS, factors, strict=True)}
        return cls(person, height, tuple(lengths), girths, correlation, path)

    @property
    def picture(self) -> Path:
        """Where the picture of the lengths lies."""
        return self.path.with_suffix(".png")

    def lines(self) -> list[str]:
        """A line for each length, and how to read them."""
        return [*(length.line for length in self.lengths), *RULE]

    def text(self) -> str:
        """The same with height, mass and the files."""
        mass = float(self.skeleton.masses.sum())
        written = [f"written  {self.path}", f"written  {self.picture}"]
        return "\n".join([f"{self.height:.3f} m, {mass:.1f} kg", *self.lines(), *written])

    def figures(self) -> dict:
        """The same for JSON."""
        return {
            "height_m": self.height,
            "mass_kg": float(self.skeleton.masses.sum()),
            "rule": " ".join(RULE),
            "lengths": {
                length.name: {key: value for key, value in asdict(length).items() if key != "name"}
                | {"verdict": length.verdict}
                for length in self.lengths
            },
            "correlation": self.correlation.tolist(),
            "girth_factors": self.girths,
        }


def plot_lengths(path: Path, lengths: Sequence[LengthEstimate], title: str) -> None:
    """Draw two deviations about each length, before and after, percent of it as stated."""
    figure, panels = new_panels(1, 1, (7.2, 0.6 + 0.48 * len(lengths)))
    axes, rows = panels[0, 0], range(len(lengths))
    widths = [400 * length.deviation_before for length in lengths]
    axes.barh(rows, widths, 0.62, [-w / 2 for w in widths], color="#e4e4e4", label="before")
    for verdict, colour in COLOURS.items():
        chosen = [row for row in rows if lengths[row].verdict == verdict]
        if chosen:
            estimates = [100 * lengths[row].change for row in chosen]
            spread = [200 * lengths[row].deviation_after for row in chosen]
            axes.errorbar(
                estimates, chosen, xerr=spread, fmt="o", color=colour, capsize=4, linewidth=2,
                label=verdict,
            )  # fmt: skip
    axes.set_yticks(rows, [f"{length.name}\n{length.length_m:.3f} m" for length in lengths])
    axes.invert_yaxis()
    ends = [
        max(2 * length.deviation_before, abs(length.change) + 2 * length.deviation_after)
        for length in lengths
    ]
    axes.axvline(0, color="#888888", linewidth=0.8)
    axes.set_xlim(-108 * max(ends), 108 * max(ends))
    axes.set_xlabel("change against what was stated [%], ± 2 standard deviations")
    axes.grid(False, axis="y")
    axes.set_axisbelow(True)
    figure.legend(loc="outside lower center", frameon=False, ncols=4, fontsize="small")
    save_figure(figure, path, title)
