"""A settings file changes what it names, and nothing else; what it gets wrong it says."""

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxmocap import Settings
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.settings_file import list_fields, read_settings
from jaxmocap.outputs.report import plain


@pytest.fixture(scope="module")
def read(tmp_path_factory):
    path = tmp_path_factory.mktemp("settings") / "settings.toml"

    def reading(text, settings=None):
        path.write_text(text, "utf-8")
        return read_settings(path, settings or Settings())

    return reading


def leaves(record, where=""):
    """Dotted name -> field and value, of every field that is no record."""
    for field in fields(record):
        value, name = getattr(record, field.name), f"{where}{field.name}"
        if is_dataclass(value):
            yield from leaves(value, f"{name}.")
        else:
            yield name, field, value


FIELDS = {name: (field, value) for name, field, value in leaves(Settings())}
NUMBERS = [name for name, (field, _) in FIELDS.items() if "dtype" in field.metadata]


def test_an_empty_file_changes_nothing(read):
    assert plain(read("")) == plain(Settings())
    assert plain(read("", Settings.paper())) == plain(Settings.paper())


def test_what_is_named_changes(read):
    actual = read(
        'refine = "none"\nregion = 120\n[edge_detection]\nthresholds = [30, 90.5]\n'
        "[ik]\niterations = 9\n[smoothing.pelvis]\nfacing = 0.2"
    )
    usual = Settings()
    smoothing = usual.smoothing
    expected = replace(
        usual,
        refine="none",
        region=120,
        edge_detection=replace(usual.edge_detection, thresholds=(30.0, 90.5)),
        ik=replace(usual.ik, iterations=9),
        smoothing=replace(smoothing, pelvis=replace(smoothing.pelvis, facing=0.2)),
    )
    assert plain(actual) == plain(expected)
    assert hash(actual.edge_detection) == hash(expected.edge_detection)


@given(st.sampled_from(NUMBERS), st.floats(0.2, 5))
def test_any_number_may_be_changed_alone(read, name, factor):
    _, usual = FIELDS[name]
    value = float(usual) * factor
    text = str(max(1, round(value))) if np.asarray(usual).dtype.kind == "i" else repr(value)
    actual = dict((each, value) for each, _, value in leaves(read(f"{name} = {text}")))
    assert actual[name].dtype == np.asarray(usual).dtype
    np.testing.assert_allclose(actual[name], float(text), rtol=1e-6)
    for other, (_, value) in FIELDS.items():
        if other != name:
            np.testing.assert_array_equal(actual[other], value)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('refine = "magic"', 'refine: found \'magic\', expected one of "simplex", "gradient"'),
        ("smooth = 1", "smooth: found 1, expected one of true, false"),
        ("elbows = 1", "unknown key 'elbows', expected refine, search,"),
        ("[ik]\nfloor_height = 1", r"\[ik\]: unknown key 'floor_height', expected goals,"),
        ("ik = 3", r"\[ik\]: found 3, expected a table"),
        ("[ik]\nmemory = '1'", r"\[ik\] memory: found '1', expected a number"),
        ("[ik]\nmemory = nan", r"\[ik\] memory: found nan, expected a number"),
        ("[ik.goals]\ndeviation = 0", r"\[ik.goals\] deviation: found 0, expected a number from"),
        ("[simplex]\niterations = 1e9", r"\[simplex\] iterations: .* from 1 to 400"),
        ("[simplex]\niterations = 1.5", "expected a whole number"),
        ("region = 100000", "region: .* from 16 to 1024"),
        ("[edge_detection]\nthresholds = [1]", "thresholds: found .*, expected 2 numbers"),
        ("[edge_detection]\npercentiles = [1, 101]", "expected numbers from 0 to 100"),
        ("refine =", "not TOML"),
    ],
)
def test_what_is_wrong_is_said_in_a_sentence(read, text, problem):
    with pytest.raises(InputError, match=f"settings.toml: {problem}|{problem}"):
        read(text)


def test_the_list_has_every_field_with_what_it_means():
    text = list_fields(Settings())
    for name, (field, _) in FIELDS.items():
        assert f"\n{name.split('.')[-1]} = " in f"\n{text}"
        assert " ".join(field.metadata["meaning"].split()[:3]) in text.replace("\n    # ", " ")


def test_the_list_is_a_settings_file_that_changes_nothing(read):
    """So a user may copy it and change a line."""
    assert plain(read(list_fields(Settings()))) == plain(Settings())


@pytest.mark.parametrize("refine", ["simplex", "gradient"])
def test_a_refinement_that_would_have_no_part_is_refused(tmp_path, refusal, refine):
    """Before anything is read of the recording."""
    chosen = tmp_path / "settings.toml"
    chosen.write_text(f'refine = "{refine}"', "utf-8")
    track = ["track", str(tmp_path / "r.toml"), "--out", str(tmp_path / "out")]
    for options, where in (
        (["--refine", refine], "--refine: "),
        (["--settings", str(chosen)], f"{chosen}: "),
    ):
        assert f'{where}found refine = "{refine}"' in refusal(*track, *options)
