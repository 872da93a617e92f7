"""Licences on the page of security against those that installed packages state."""

import importlib.metadata
import re
import tomllib
from pathlib import Path

import pytest

import jaxmocap

ROOT = Path(jaxmocap.__file__).parents[1]
PAGE = (ROOT / "jaxmocap/docs/security.md").read_text("utf-8").partition("## Licences")[2]
STATED = {
    name: licence
    for names, licence in re.findall(r"^\| ([\w, -]+?) \| (.+) \|$", PAGE, re.MULTILINE)
    for name in names.split(", ")
}
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
NEEDED = PROJECT["dependencies"] + [
    r for extra in ("cluster", "lsl", "onnx") for r in EXTRAS[extra]
]


def test_every_dependency_is_on_the_page_and_has_an_upper_bound():
    names = {re.match(r"[\w.-]+", each)[0] for each in NEEDED}
    assert names == set(STATED) - {"package"} and all("<" in each for each in NEEDED)


@pytest.mark.parametrize("name", sorted(set(STATED) - {"package", "python-osc"}))
def test_a_licence_is_as_its_package_states(name):
    try:
        metadata = importlib.metadata.metadata(name)
    except importlib.metadata.PackageNotFoundError:
        pytest.skip(f"{name} is not installed here: an extra of pyproject.toml brings it")
    fields = ("License-Expression", "License", "Classifier")
    actual = " ".join(text for field in fields for text in metadata.get_all(field, []))
    if not actual.strip():
        pytest.skip(f"the installed {name} states no licence to compare the page with")
    word = re.match(r"MPL|MIT|BSD|Apache|Python", STATED[name])[0]
    assert word.lower() in actual.lower()
    assert bool(re.search(r"\bMPL\b", actual)) == ("MPL" in STATED[name])
