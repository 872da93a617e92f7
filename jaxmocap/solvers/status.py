"""Why a solve ended, as data: inside jit nothing is raised.

INPUTS: what a solver found. OUTPUTS: a Status, and its sentence on the host.
"""

from enum import IntEnum


class Status(IntEnum):
    """How a solve ended; an int32 array inside jit."""

    CONVERGED = 0
    OUT_OF_STEPS = 1
    BROKEN = 2
    STALLED = 3
    UNDETERMINED = 4


# They hold no figures, so that a report can count them.
SENTENCES = {
    Status.CONVERGED: "",
    Status.OUT_OF_STEPS: "had not converged after its largest number of steps",
    Status.BROKEN: "broke down and left its start as it was",
    Status.STALLED: "stopped where no step lowered its cost",
    Status.UNDETERMINED: "left unknowns as they were that nothing determines",
}
