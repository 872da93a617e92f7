"""Mutated inputs of all formats: one clean sentence or a result, in bounded time and memory.

Whatever fails is named with the line that runs it again; ``hostile_inputs.py`` has the table.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from hostile_inputs import ARGUMENTS, DEEP, copy_inputs, kind_of, make_case, run_cases, table
from hostile_kinds import BY_KIND, KINDS
from hostile_pool import Answer, Pool
from hostile_verdicts import Snapshot, faults, of_sentence, printed

SEED = 20
# Of every kind of input; together some 300.
EACH = 10
MANY, ANOTHER_SEED = 2000, 21
NAMES = [*BY_KIND, ARGUMENTS]

pytestmark = pytest.mark.skipif(
    sys.platform == "win32", reason="Windows has no such pipes and links"
)


@pytest.fixture(scope="module")
def pool(tmp_path_factory):
    with Pool(tmp_path_factory.mktemp("hostile"), min(2, os.cpu_count() or 1)) as pool:
        yield pool


def failures(cases) -> str:
    return "\n\n".join(case.text() for case in cases if case.faults)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_inputs_are_taken_as_they_are_before_they_are_mutated(kind, pool, tmp_path):
    for command in dict.fromkeys(kind.commands):
        shutil.rmtree(tmp_path)
        (tmp_path / DEEP / "out").mkdir(parents=True)
        copy_inputs(kind, pool.bases, tmp_path / DEEP / "in")
        answer = pool.run(command.split(), tmp_path / DEEP, tmp_path)
        # So short a recording does not tell an offset.
        expected = 1 if command.startswith("sync") else kind.ends
        assert answer.code == expected, f"jaxmocap {command}: {answer.err}"


@pytest.mark.parametrize("name", NAMES)
def test_mutated_inputs_end_well_or_in_one_sentence(name, pool, tmp_path):
    numbers = [number for number in range(EACH * (len(NAMES) + 1)) if kind_of(number) == name]
    assert not (actual := failures(run_cases(SEED, numbers, pool, tmp_path))), actual


@pytest.mark.slow
def test_two_thousand_mutated_inputs_end_well_or_in_one_sentence(pool, tmp_path):
    cases = run_cases(ANOTHER_SEED, range(MANY), pool, tmp_path, costly=True)
    print(table(cases))
    assert not (actual := failures(cases)), actual


def test_the_command_line_that_a_case_names_runs():
    script = Path(__file__).with_name("hostile_inputs.py")
    subprocess.run([sys.executable, script, "--help"], check=True, stdout=subprocess.DEVNULL)


def test_a_case_is_the_same_each_time_it_is_made(pool, tmp_path):
    made = [_made(name, pool, tmp_path) for name in ("first", "second")]
    assert made[0] == made[1]


def _made(name: str, pool: Pool, folder: Path):
    cases = [make_case(SEED, i, pool.bases, folder / name / str(i)) for i in range(12)]
    shown = [(case.done, case.arguments) for case in cases]
    held = {path: was for path, was in Snapshot.of(folder / name).items() if "odd" not in path}
    return shown, held


def faults_in(
    tmp_path: Path, before=None, code=2, err="jaxmocap check: a.toml: no such file\n", **message
):
    """What is found of an answer; ``before`` is done to the folder meanwhile."""
    inside = tmp_path / DEEP
    (inside / "out").mkdir(parents=True)
    (inside / "input").write_text("as it was")
    (inside / "out" / "earlier").write_text("as it was")
    was = Snapshot.of(tmp_path)
    if before is not None:
        before(inside)
    answer = Answer(
        code, message.pop("seconds", 1.0), message.pop("memory", 10**8), "", err, **message
    )
    return " ".join(faults(answer, was, Snapshot.of(tmp_path), DEEP))


def test_one_sentence_and_exit_code_2_are_as_promised(tmp_path):
    assert (
        faults_in(tmp_path, err="drawing:  40%|####\rjaxmocap check: a.toml: no such file\n") == ""
    )


@pytest.mark.parametrize(
    "message, actual",
    [
        ({"err": "Traceback (most recent call last):\nKeyError: 'a'\n"}, "traceback"),
        ({"err": ""}, "0 lines on stderr"),
        ({"err": "moov atom not found\njaxmocap check: a.mp4: is not a video\n"}, "2 lines"),
        ({"err": "jaxmocap check: None: No space left\n"}, "the program's inside"),
        ({"err": "jaxmocap check: \x1b[31ma.toml: no such file\n"}, "steer"),
        ({"err": f"jaxmocap check: {'a' * 700}: no such file\n"}, "characters"),
        ({"code": 3}, "exit code 3"),
        ({"seconds": 61.0}, "took 61 s"),
        ({"memory": 3 * 2**30}, "took 3.0 GB"),
        ({"ended": "no end within 60 s", "code": None}, "no end"),
        ({"left": ("decoder",)}, "threads that do not end"),
    ],
)
def test_what_breaks_the_promise_is_found(message, actual, tmp_path):
    assert actual in faults_in(tmp_path, **message)


@pytest.mark.parametrize(
    "act, actual",
    [
        (lambda inside: (inside / "input").write_text("other"), "input was changed"),
        (lambda inside: (inside / "input").unlink(), "input is gone"),
        (lambda inside: (inside / "out" / "earlier").write_text("other"), "the earlier"),
        (lambda inside: (inside / ".." / "EVIL").write_text("other"), "written outside"),
        (lambda inside: (inside / "out" / ".part").write_text("other"), "hidden"),
    ],
)
def test_files_that_are_changed_lost_or_left_are_found(act, actual, tmp_path):
    assert actual in faults_in(tmp_path, act)


def test_progress_is_no_sentence():
    assert not printed("    0.06 s  missing: none\ncompiling 0 s |   0 /s | dropped 0 samples\n")
    assert printed("tracking: 0it [00:00, ?it/s]\rtracking:  50%|##\n\njaxmocap a: b\n") == [
        "jaxmocap a: b"
    ]
    assert of_sentence("jaxmocap a: file.toml: no such file") == []
