"""Errors as plain text.

INPUTS: Errors. OUTPUTS: a table to print.
"""

from collections.abc import Sequence

from jaxmocap.evaluation.errors import Errors

# Key of Errors.as_dict() -> heading, unit, factor from SI, digits.
COLUMNS = {
    "samples": ("samples", "", 1, 0),
    "mean_m": ("mean", "cm", 100, 2),
    "median_m": ("median", "cm", 100, 2),
    "p95_m": ("95 %", "cm", 100, 2),
    "rms_m": ("RMS", "cm", 100, 2),
    "high_pass_rms_m": ("> 0.3 Hz", "cm", 100, 2),
    "jitter_m_s2": ("jitter", "m/s²", 1, 1),
}
# The same where deviations were stated.
STATED_COLUMNS = {
    "stated_m": ("stated", "± cm", 100, 2),
    "within_90_share": ("in 90 %", "%", 100, 0),
    "error_over_stated": ("error / ±", "", 1, 2),
}


def format_table(errors: Errors, before: Errors | None = None) -> str:
    """A plain text table, one row per joint and one for their mean; centimetres.

    With ``before`` two more columns: the mean error before, and by how much it fell.
    """
    is_stated = "stated_m" in errors.as_dict()["mean_over_joints"]
    columns = COLUMNS | (STATED_COLUMNS if is_stated else {})
    rows = [
        ["joint", *(heading for heading, *_ in columns.values())],
        ["", *(unit for _, unit, *_ in columns.values())],
    ]
    for name, figures in _by_row(errors).items():
        cells = (_number(figures[key], *how) for key, (_, _, *how) in columns.items())
        rows.append([name, *cells])
    if before is not None:
        rows[0] += ["before", "improved"]
        rows[1] += ["cm", "%"]
        old = _by_row(before)
        for row, (name, figures) in zip(rows[2:], _by_row(errors).items(), strict=True):
            mean, now = old.get(name, {}).get("mean_m"), figures["mean_m"]
            gain = 1 - now / mean if mean and now is not None else None
            row += [_number(mean, 100, 2), _number(gain, 100, 0)]
    return align_columns(rows)


def _by_row(errors: Errors) -> dict[str, dict]:
    figures = errors.as_dict()
    return figures["joints"] | {"mean": figures["mean_over_joints"]}


def _number(value: float | None, factor: float, digits: int) -> str:
    return "-" if value is None else f"{factor * value:.{digits}f}"


def align_columns(rows: Sequence[Sequence[str]]) -> str:
    """First column to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for first, *others in rows:
        cells = [cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)]
        lines.append("  ".join([first.ljust(widths[0]), *cells]).rstrip())
    return "\n".join(lines)
