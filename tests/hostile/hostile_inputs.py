"""Hostile inputs: made by a seed, run in processes with limits, held against what is promised.

    python tests/hostile/hostile_inputs.py --count 2000 --seed 7
        a table of what came of them
    python tests/hostile/hostile_inputs.py --seed 7 --case 123 --keep F
        one again, its files left in F

INPUTS: a seed, numbers of cases. OUTPUTS: what each broke of the promise: no traceback, no hang, a
bounded memory, one clean sentence, and nothing changed but the outputs.
"""

import argparse
import os
import shutil
import socket
import stat
import sys
import tempfile
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

# As pytest has it, for the command line that a case names.
sys.path.append(str(Path(__file__).parents[1] / "subjects"))
from hostile_kinds import ARGUMENTS, BY_KIND, KINDS, MORE_COMMANDS, Kind
from hostile_mutations import BYTES, MOST, MUTATIONS, recoded
from hostile_pool import Answer, Pool
from hostile_values import ODD, brief, hostile_number, hostile_text
from hostile_verdicts import Snapshot, faults

# What cases are about, in turn; arguments most often.
TURNS = (*BY_KIND, ARGUMENTS, ARGUMENTS)
# Deep enough that a name with some ".." in it still lies within the case's folder.
DEEP = Path("a/b/c/d")
# Shares of cases: bytes of any file; things that are no files in place of one; earlier outputs.
ANY_FILE, NO_FILE, HAS_EARLIER = 0.3, 0.06, 0.5
# Of the commands that track, where they may be taken.
COSTLY = 0.1


@dataclass
class Case:
    """A command line and the files that it is about."""

    seed: int
    number: int  # among those of the seed
    kind: str
    folder: Path  # the command runs in ``inside``
    arguments: list[str] = field(default_factory=list)
    done: list[str] = field(default_factory=list)  # what was made hostile, in a few words
    faults: list[str] = field(default_factory=list)  # what it broke of the promise
    answer: Answer | None = None

    @property
    def inside(self) -> Path:
        return self.folder / DEEP

    def text(self) -> str:
        """What went wrong, and how to see it again."""
        shown = (a if len(a) <= 40 and a.isprintable() else brief(a) for a in self.arguments)
        again = f"--seed {self.seed} --case {self.number} --keep FOLDER"
        lines = [f"{self.kind}: {'; '.join(self.done)}", f"jaxmocap {' '.join(shown)}"]
        lines += [*self.faults, f"python tests/hostile/hostile_inputs.py {again}"]
        return "\n    ".join(lines)


def kind_of(number: int) -> str:
    """What a case is about."""
    return TURNS[number % len(TURNS)]


def make_case(seed: int, number: int, bases: Path, folder: Path, costly: bool = False) -> Case:
    """Write a case's files, from valid ones; seed and number together make it what it is."""
    rng = np.random.default_rng([seed, number])
    case = Case(seed, number, kind_of(number), folder)
    (case.inside / "out").mkdir(parents=True)
    if case.kind == ARGUMENTS:
        kind = KINDS[rng.integers(len(KINDS))]
        commands = kind.commands if rng.random() < 0.6 else MORE_COMMANDS
        case.arguments = str(rng.choice(commands)).split()
        shutil.copytree(bases, case.inside / "in")
    else:
        kind = BY_KIND[case.kind]
        is_costly = kind.costly and costly and rng.random() < COSTLY
        case.arguments = str(rng.choice(kind.costly if is_costly else kind.commands)).split()
        copy_inputs(kind, bases, case.inside / "in")
    odd_files(case.inside / "odd")
    # A name in a file of inputs is relative to it.
    os.symlink(Path("..") / "odd", case.inside / "in" / "odd", target_is_directory=True)
    if case.kind == ARGUMENTS:
        for _ in range(int(rng.choice([1, 1, 2]))):
            case.done.append(change_arguments(rng, case.arguments))
    else:
        change_file(rng, case, kind)
    if rng.random() <= HAS_EARLIER:
        write_earlier_outputs(case, bases)
    return case


def copy_inputs(kind: Kind, bases: Path, target: Path) -> None:
    """The files of a kind and those that its commands need."""
    target.mkdir()
    others = {"motion.npz", "subject.toml", "lens.toml", "points.csv", "people.npz"}
    for name in sorted({*kind.files, *kind.also, *others}):
        (target / name).parent.mkdir(exist_ok=True)
        if (bases / name).is_dir():
            shutil.copytree(bases / name, target / name, dirs_exist_ok=True)
        else:
            shutil.copy2(bases / name, target / name)


def change_file(rng: np.random.Generator, case: Case, kind: Kind) -> None:
    """Make one file of a kind hostile."""
    named = [name for name in kind.files if f"in/{name}" in case.arguments] or kind.files
    name = named[rng.integers(len(named))]
    path = case.inside / "in" / name
    if rng.random() < NO_FILE:
        odd = str(rng.choice(ODD))
        path.unlink()
        os.symlink(os.path.relpath(case.inside / "odd" / odd, path.parent), path)
        case.done.append(f"{name} is {odd}")
        return
    own, content = MUTATIONS[path.suffix], path.read_bytes()
    for _ in range(int(rng.choice([1, 1, 1, 2]))):
        some = BYTES if not own or rng.random() < ANY_FILE else own
        mutate, before = some[rng.integers(len(some))], content
        try:
            content = mutate(rng, content)
        except Exception:
            # What was hostile already cannot be taken apart any more.
            mutate, content = recoded, recoded(rng, content)
        case.done.append(f"{name}: {mutate.__name__}, {first_difference(before, content)}")
        # A bomb is not to be taken apart here.
        if len(content) > MOST:
            break
    path.write_bytes(content)


def first_difference(before: bytes, after: bytes) -> str:
    """Where a content differs from another first, in a few words."""
    differs = (i for i, (a, b) in enumerate(zip(before, after, strict=False)) if a != b)
    at = next(differs, min(len(before), len(after)))
    return f"{brief(before[at : at + 20])} = {brief(after[at : at + 20])} from byte {at} on"


def change_arguments(rng: np.random.Generator, arguments: list[str]) -> str:
    """Change one of the arguments, leave one out, or add one; what was done."""
    at = int(rng.integers(1, max(2, len(arguments)))) if len(arguments) > 1 else 0
    old, how = arguments[at], rng.integers(10)
    if how == 0:
        del arguments[at]
        return f"without {old}"
    if how == 1:
        arguments.insert(at, new := hostile_text(rng))
        return f"{brief(new)} before {old}"
    if how == 2:
        arguments += [old]
        return f"{old} twice"
    texts = [hostile_text(rng), hostile_number(rng), f"in/{hostile_text(rng)}", "in", "odd/zeros"]
    texts += [f"out/{hostile_text(rng)}", "a\udcff", "in/notes.txt", "in/notes.txt/x", "x" * 5000]
    if old.startswith("out/"):
        # The earlier output is a folder, or below a file, or a pipe.
        texts = [*texts[5:], "out", "odd/pipe", "odd/loop", "odd/gone", "odd/folder", "in", "."]
        texts += [f"{old}/{hostile_text(rng)}", old + hostile_text(rng)]
    new = texts[rng.integers(len(texts))]
    name, equals, _ = old.partition("=")
    arguments[at] = f"{name}={new}" if equals and rng.random() < 0.5 else new
    return f"{old} = {brief(new)}"


def odd_files(folder: Path) -> None:
    """Things that are no regular files, as far as this system has them."""
    (folder / "folder").mkdir(parents=True)
    (folder / "empty").touch()
    (folder / "locked").write_bytes(b"locked")
    (folder / "locked").chmod(0)
    for name, target in {"loop": "loop", "gone": "nowhere", "self": "/proc/self"}.items():
        os.symlink(target, folder / name)
    for name, device, minor in (("zeros", "zero", 5), ("noise", "urandom", 9)):
        # Endless; for root, who could replace the system's own, another one like it. There is none
        # where containers may not make any.
        if sys.platform != "linux" or os.geteuid():
            os.symlink(f"/dev/{device}", folder / name)
            continue
        with suppress(OSError):
            os.mknod(folder / name, stat.S_IFCHR | 0o666, os.makedev(1, minor))
    if hasattr(os, "mkfifo"):
        os.mkfifo(folder / "pipe")
    if hasattr(socket, "AF_UNIX"):
        with socket.socket(socket.AF_UNIX) as listening:
            here = os.open(folder, os.O_RDONLY)
            # A socket's whole path may have a hundred characters only.
            with suppress(OSError):
                listening.bind(f"/proc/self/fd/{here}/socket")
            os.close(here)


def write_earlier_outputs(case: Case, bases: Path) -> None:
    """What an earlier run left where this one is to write."""
    for name in [a for a in case.arguments if a.startswith("out/") and a.isprintable()]:
        path = case.inside / name
        if len(name) > 40 or ".." in name or path.exists():
            continue
        left = b"what an earlier run left\n"
        content = (bases / "lens.toml").read_bytes() if path.suffix == ".toml" else left
        path = path if path.suffix else path / "notes.txt"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def named(case: Case) -> set[str]:
    """What hostile arguments name themselves, and where links among it lead: it may be written."""
    root, actual = os.path.realpath(case.folder), set()
    for argument in case.arguments if case.kind == ARGUMENTS else ():
        name = argument.rpartition("=")[2]
        # What no file can be called leads nowhere.
        if "\0" not in name and len(name) <= 255:
            path = os.path.join(root, DEEP, name)
            actual |= {os.path.relpath(way, root) for way in (path, os.path.realpath(path))}
    return actual


def run_cases(
    seed: int, numbers, pool: Pool, where: Path, costly: bool = False, show=None
) -> list[Case]:
    """Make, run and check cases, side by side; their folders are removed unless they are shown."""

    def one(number: int) -> Case:
        case = make_case(seed, number, pool.bases, where / f"{seed}-{number}", costly)
        before = Snapshot.of(case.folder)
        case.answer = pool.run(case.arguments, case.inside, case.folder)
        case.faults = faults(case.answer, before, Snapshot.of(case.folder), DEEP, named(case))
        if show is None or not show(case):
            shutil.rmtree(case.folder, ignore_errors=True)
        return case

    return pool.each(one, numbers)


def table(cases: list[Case]) -> str:
    """Kinds by what came of them; the slowest and the largest."""
    columns = ["0", "1", "2", "fault"]
    counts = Counter((c.kind, "fault" if c.faults else str(c.answer.code)) for c in cases)
    for (_, what), count in list(counts.items()):
        counts["all", what] += count
    lines = [f"{'':22}" + "".join(f"{name:>8}" for name in columns)]
    for kind in [*BY_KIND, ARGUMENTS, "all"]:
        lines.append(f"{kind:22}" + "".join(f"{counts[kind, name]:8}" for name in columns))
    slowest = max(cases, key=lambda case: case.answer.seconds)
    largest = max(cases, key=lambda case: case.answer.memory or 0)
    lines.append(f"slowest: {slowest.answer.seconds:.1f} s, case {slowest.number} ({slowest.kind})")
    size = (largest.answer.memory or 0) / 2**20
    return "\n".join([*lines, f"largest: {size:.0f} MB, case {largest.number} ({largest.kind})"])


def main() -> int:
    """Run many cases, or one again."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--case", type=int, help="one case alone")
    parser.add_argument("--keep", type=Path, help="folder for its files")
    parser.add_argument("--cheap", action="store_true", help="no costly commands, as in CI")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    is_alone = options.case is not None
    numbers = [options.case] if is_alone else range(options.count)

    def show(case: Case) -> bool:
        if case.faults or is_alone:
            print(case.text(), flush=True)
        return is_alone

    with tempfile.TemporaryDirectory() as folder:
        where = options.keep or Path(folder)
        shutil.rmtree(where / f"{options.seed}-{options.case}", ignore_errors=True)
        with Pool(Path(folder), 1 if is_alone else options.workers) as pool:
            cases = run_cases(options.seed, numbers, pool, where, not options.cheap, show)
        print(table(cases))
        if is_alone:
            answer = cases[0].answer
            print(f"--- stdout\n{answer.out[-2000:]}\n--- stderr\n{answer.err[-4000:]}")
    return int(any(case.faults for case in cases))


if __name__ == "__main__":
    sys.exit(main())
