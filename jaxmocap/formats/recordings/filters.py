"""[markers.filters] of a recording: what is done to the markers before they are tracked.

INPUTS: a table with ``hampel`` (true or false), ``gaps`` (seconds), ``butterworth`` (Hz) and
``one_euro`` (true, or ``{ cutoff = Hz, beta = Hz per m/s }``).
OUTPUTS: Filters. What is not named is off.
"""

from dataclasses import dataclass

from jaxmocap.formats.files.toml import TomlTable

# Hz and seconds that filters may have.
VALUES = (1e-6, 1e6, "a positive number")
FILTER_KEYS = ("hampel", "gaps", "butterworth", "one_euro")


@dataclass(frozen=True)
class OneEuroSettings:
    """The One Euro filter's two parameters.

    At rest it lags by 1 / (2 pi cutoff) seconds; at any steady speed it stays behind by less than
    1 / (2 pi beta) metres. As they are, a hand at rest keeps 0.44 of its jitter, and one that
    strikes at 5 m/s stays behind by 4 mm at most.
    """

    cutoff: float = 3.0  # Hz, of a marker at rest
    beta: float = 60.0  # Hz that the cut-off rises by for every metre per second


@dataclass(frozen=True)
class Filters:
    """Which filters markers go through, in this order; nothing by default."""

    hampel: bool = False  # take outliers for missing
    gaps: float = 0.0  # fill in what is missing for up to so many seconds; 0 fills nothing
    butterworth: float | None = None  # cut-off of the zero-phase low-pass, Hz, or None
    # Of the filter without look-ahead, which is for ``--causal`` and ``live`` only, as the three
    # above are for all else; or None.
    one_euro: OneEuroSettings | None = None


def read_filters(fields: TomlTable) -> Filters:
    """Filters of the table; InputError for a field of another kind, or not above 0."""
    named = [key for key in ("gaps", "butterworth") if key in fields]
    stated = {key: fields.number(key, None, *VALUES) for key in named}
    return Filters(hampel=fields.flag("hampel"), one_euro=_one_euro(fields), **stated)


def _one_euro(fields: TomlTable) -> OneEuroSettings | None:
    value, default = fields.entries.get("one_euro", False), OneEuroSettings()
    if isinstance(value, bool):
        return default if value else None
    table = TomlTable(fields.path, f"{fields.where} one_euro", value, ("cutoff", "beta"))
    return OneEuroSettings(
        table.number("cutoff", default.cutoff, *VALUES), table.number("beta", default.beta, *VALUES)
    )
