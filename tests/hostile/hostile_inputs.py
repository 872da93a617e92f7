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

# Deep enough that a name with some ".." in it still lies within the case's folder.
DEEP = Path("a/b/c/d")
EARLIER = b"what an earlier run left\n"
# Shares of cases: bytes of any file; things that are no files in place of one; earlier outputs.
ANY_FILE, NO_FILE, HAS_EARLIER = 0.3, 0.06, 0.5
ENDLESS = {"zero": "zeros", "urandom": "noise"}
# Of the commands that track, where they may be taken.
COSTLY = 0.1


@dataclass
class Case:
    """A command line and the files that it is about.

    Attributes:
        seed: of the case, and ``number``: among those of the seed.
        kind: of input.
        folder: of the case; the command runs in ``folder / DEEP``.
        arguments: of the command.
        done: what was made hostile, in a few words.
        faults: what it broke of the promise, once it was run.
        answer: what running it took.
    """

    seed: int
    number: int
    kind: str
    folder: Path
    arguments: list[str]
    done: list[str]
    faults: list[str] = field(default_factory=list)
    answer: Answer | None = None

    @property
    def inside(self) -> Path:
        """The folder that the command runs in."""
        return self.folder / DEEP

    def text(self) -> str:
        """What went wrong, and how to see it again."""
        shown = " ".join(
            brief(a) if len(a) > 40 or not a.isprintable() else a for a in self.arguments
        )
        return (
            f"{self.kind}: {'; '.join(self.done)}\n    jaxmocap {shown}\n    "
            + "\n    ".join(self.faults)
            + "\n    python tests/hostile/hostile_inputs.py "
            f"--seed {self.seed} --case {self.number} --keep FOLDER"
        )


def kind_of(number: int) -> str:
    """What a case is about: all kinds in turn, arguments most often."""
    names = [*BY_KIND, ARGUMENTS, ARGUMENTS]
    return names[number % len(names)]


def make_case(seed: int, number: int, bases: Path, folder: Path, costly: bool = False) -> Case:
    """Write a case's files.

    Args:
        seed: of it.
        number: of it; both together make it what it is.
        bases: folder of valid files, by ``hostile_bases``.
        folder: for the case, which is made.
        costly: choose among the costly commands too.
    """
    rng = np.random.default_rng([seed, number])
    name = kind_of(number)
    case = Case(seed, number, name, folder, [], [])
    (case.inside / "out").mkdir(parents=True)
    if name == ARGUMENTS:
        kind = KINDS[rng.integers(len(KINDS))]
        commands = kind.commands if rng.random() < 0.6 else MORE_COMMANDS
        case.arguments = str(rng.choice(commands)).split()
        shutil.copytree(bases, case.inside / "in")
    else:
        kind = BY_KIND[name]
        commands = kind.commands
        if kind.costly and costly and rng.random() < COSTLY:
            commands = kind.costly
        case.arguments = str(rng.choice(commands)).split()
        copy_inputs(kind, bases, case.inside / "in")
    odd_files(case.inside / "odd")
    # A name in a file of inputs is relative to it.
    os.symlink(Path("..") / "odd", case.inside / "in" / "odd", target_is_directory=True)
    if name == ARGUMENTS:
        for _ in range(int(rng.choice([1, 1, 2]))):
            case.done.append(change_arguments(rng, case.arguments))
    else:
        change_file(rng, case, kind)
    earlier_outputs(rng, case, bases)
    return case


def copy_inputs(kind: Kind, bases: Path, target: Path) -> None:
    """The files of a kind and those that its commands need."""
    target.mkdir()
    for name in {*kind.files, *kind.also}:
        (target / name).parent.mkdir(exist_ok=True)
        copy = shutil.copytree if (bases / name).is_dir() else shutil.copy2
        options = {"dirs_exist_ok": True} if (bases / name).is_dir() else {}
        copy(bases / name, target / name, **options)
    for other in ("motion.npz", "subject.toml", "lens.toml", "points.csv", "people.npz"):
        if not (target / other).exists():
            shutil.copy2(bases / other, target / other)


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
    own = MUTATIONS[path.suffix]
    content = path.read_bytes()
    for _ in range(int(rng.choice([1, 1, 1, 2]))):
        some = BYTES if not own or rng.random() < ANY_FILE else own
        mutate = some[rng.integers(len(some))]
        before = content
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
    """Change one of the arguments, leave one out, or add one."""
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
    folder.mkdir()
    (folder / "folder").mkdir()
    (folder / "empty").touch()
    (folder / "locked").write_bytes(b"locked")
    (folder / "locked").chmod(0)
    for name, target in {"loop": "loop", "gone": "nowhere", "self": "/proc/self"}.items():
        os.symlink(target, folder / name)
    for name, minor in {"zero": 5, "urandom": 9}.items():
        _device(folder / ENDLESS[name], name, minor)
    if hasattr(os, "mkfifo"):
        os.mkfifo(folder / "pipe")
    if hasattr(socket, "AF_UNIX"):
        with socket.socket(socket.AF_UNIX) as listening:
            here = os.open(folder, os.O_RDONLY)
            # A socket's whole path may have a hundred characters only.
            with suppress(OSError):
                listening.bind(f"/proc/self/fd/{here}/socket")
            os.close(here)


def _device(path: Path, name: str, minor: int) -> None:
    """An endless device; for root, who could replace the system's own, another one like it."""
    if sys.platform != "linux" or os.geteuid():
        os.symlink(f"/dev/{name}", path)
        return
    # There is none where containers may not make any.
    with suppress(OSError):
        os.mknod(path, stat.S_IFCHR | 0o666, os.makedev(1, minor))


def earlier_outputs(rng: np.random.Generator, case: Case, bases: Path) -> None:
    """What an earlier run left where this one is to write."""
    if rng.random() > HAS_EARLIER:
        return
    for name in [a for a in case.arguments if a.startswith("out/") and a.isprintable()]:
        path = case.inside / name
        if len(name) > 40 or ".." in name or path.exists():
            continue
        if path.suffix == ".toml":
            _write(path, (bases / "lens.toml").read_bytes())
        else:
            _write(path if path.suffix else path / "notes.txt", EARLIER)


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


def run_case(case: Case, pool: Pool) -> Case:
    """Run a case in one of the pool's processes and check it."""
    before = Snapshot.of(case.folder)
    case.answer = pool.run(case.arguments, case.inside, case.folder)
    case.faults = faults(case.answer, before, Snapshot.of(case.folder), DEEP, named(case))
    return case


def named(case: Case) -> set[str]:
    """What hostile arguments name themselves, and where links among it lead: it may be written."""
    if case.kind != ARGUMENTS:
        return set()
    root, actual = os.path.realpath(case.folder), set()
    for argument in case.arguments:
        name = argument.rpartition("=")[2]
        # What no file can be called leads nowhere.
        if "\0" in name or len(name) > 255:
            continue
        path = os.path.join(root, DEEP, name)
        actual |= {os.path.relpath(way, root) for way in (path, os.path.realpath(path))}
    return actual


def run_cases(
    seed: int, numbers, pool: Pool, where: Path, costly: bool = False, show=None
) -> list[Case]:
    """Make, run and check cases, side by side; the folders of those without a fault are removed."""

    def one(number: int) -> Case:
        folder = where / f"{seed}-{number}"
        case = run_case(make_case(seed, number, pool.bases, folder, costly), pool)
        shutil.rmtree(folder, ignore_errors=True)
        if show is not None:
            show(case)
        return case

    return pool.each(one, numbers)


def table(cases: list[Case]) -> str:
    """Kinds by what came of them; the slowest and the largest."""
    columns = ["0", "1", "2", "fault"]
    counts = Counter((c.kind, "fault" if c.faults else str(c.answer.code)) for c in cases)
    lines = [f"{'':22}" + "".join(f"{name:>8}" for name in columns)]
    for kind in [*BY_KIND, ARGUMENTS]:
        lines.append(f"{kind:22}" + "".join(f"{counts[kind, name]:8}" for name in columns))
    sums = (sum(counts[kind, name] for kind in [*BY_KIND, ARGUMENTS]) for name in columns)
    lines.append(f"{'all':22}" + "".join(f"{count:8}" for count in sums))
    slowest = max(cases, key=lambda case: case.answer.seconds)
    largest = max(cases, key=lambda case: case.answer.memory or 0)
    lines.append(f"slowest: {slowest.answer.seconds:.1f} s, case {slowest.number} ({slowest.kind})")
    if largest.answer.memory:
        size = largest.answer.memory / 2**20
        lines.append(f"largest: {size:.0f} MB, case {largest.number} ({largest.kind})")
    return "\n".join(lines)


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
    with tempfile.TemporaryDirectory() as folder:
        where = options.keep or Path(folder)
        shutil.rmtree(where / f"{options.seed}-{options.case}", ignore_errors=True)
        with Pool(Path(folder), 1 if options.case is not None else options.workers) as pool:
            if options.case is not None:
                return _again(options, pool, where)
            cases = run_cases(
                options.seed, range(options.count), pool, where, not options.cheap, _show
            )
    print(table(cases))
    return int(any(case.faults for case in cases))


def _show(case: Case) -> None:
    if case.faults:
        print(case.text(), flush=True)


def _again(options: argparse.Namespace, pool: Pool, where: Path) -> int:
    folder = where / f"{options.seed}-{options.case}"
    case = make_case(options.seed, options.case, pool.bases, folder, not options.cheap)
    case = run_case(case, pool)
    print(case.text())
    answer = case.answer
    print(f"code {answer.code}, {answer.seconds:.2f} s, {(answer.memory or 0) / 2**20:.0f} MB")
    print(f"--- stdout\n{answer.out[-2000:]}\n--- stderr\n{answer.err[-4000:]}")
    return int(bool(case.faults))


if __name__ == "__main__":
    sys.exit(main())
