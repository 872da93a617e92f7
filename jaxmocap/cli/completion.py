"""``--install-completion`` and ``--show-completion``: the shell completes commands and files.

INPUTS: the parser of all commands, a shell's name. OUTPUTS: the shell's script, printed or written
into the user's own folder, and how to activate it.
"""

import argparse
import os
from collections.abc import Iterator
from pathlib import Path, PurePath
from typing import Any

from jaxmocap.formats.files.errors import FileError, InputError, printable
from jaxmocap.formats.files.writing import check_target, write_text

INSTALL, SHOW = "--install-completion", "--show-completion"
SHELLS = ("bash", "zsh", "fish")
# What a value is called in --help, where any file can be meant, or a folder.
_FILES = ("FILE", "FROM", "IMAGE", "IMAGE|VIDEO", "PERSON", "TO", "TRUTH.trc")
_FOLDERS = ("CORPUS_DIR", "DIR")


class ShowCompletion(argparse.Action):
    """Prints the script of a shell, and ends."""

    def __call__(self, parser, namespace, values, option_string=None):
        """Print it."""
        print(completion_script(parser, str(values)))
        parser.exit()


class InstallCompletion(argparse.Action):
    """Writes the script of a shell into the user's own folder, and ends; an earlier one goes."""

    def __call__(self, parser, namespace, values, option_string=None):
        """Write it; the exit code is 2 where there is no such place, and 1 on a full disk."""
        try:
            shell = str(values) if values else current_shell()
            path, activation = installation(shell)
            check_target(path)
            write_text(path, completion_script(parser, shell) + "\n")
        except FileError as error:
            code = 2 if isinstance(error, InputError) else 1
            parser.exit(code, f"{parser.prog}: {printable(str(error))}\n")
        print(f"written  {printable(str(path))}\n{activation}")
        parser.exit()


def add_completion(parser: argparse.ArgumentParser) -> None:
    """The options --install-completion and --show-completion."""
    parser.add_argument(
        INSTALL,
        action=InstallCompletion,
        nargs="?",
        choices=SHELLS,
        metavar="SHELL",
        help=f"write the file by which a shell completes commands: {', '.join(SHELLS)}; default: "
        "the shell of $SHELL",
    )
    parser.add_argument(
        SHOW, action=ShowCompletion, choices=SHELLS, metavar="SHELL", help="print that file"
    )


def current_shell() -> str:
    """The user's shell, by $SHELL.

    Raises:
        InputError: it is not one of ``SHELLS``.
    """
    name = PurePath(os.environ.get("SHELL", "")).name
    if name not in SHELLS:
        expected = " or ".join(f"{INSTALL} {shell}" for shell in SHELLS)
        raise InputError("$SHELL", f"found {name or 'nothing'}, expected {expected}")
    return name


def installation(shell: str) -> tuple[Path, str]:
    """Where a shell looks for the script of ``jaxmocap``, by the XDG folders; its activation."""
    data = _folder("XDG_DATA_HOME", ".local", "share")
    match shell:
        case "bash":
            own = os.environ.get("BASH_COMPLETION_USER_DIR")
            path = (Path(own) if own else data / "bash-completion") / "completions" / "jaxmocap"
            text = "Open a new terminal. Without the package bash-completion, add this line to "
            return path, f"{text}~/.bashrc:\n    source {printable(str(path))}"
        case "zsh":
            path = data / "zsh" / "site-functions" / "_jaxmocap"
            lines = f"fpath=({printable(str(path.parent))} $fpath)\n    autoload -Uz compinit"
            text = "Add these lines to ~/.zshrc, and open a new terminal:\n    "
            return path, f"{text}{lines} && compinit"
    path = _folder("XDG_CONFIG_HOME", ".config") / "fish" / "completions" / "jaxmocap.fish"
    return path, "Open a new terminal."


def _folder(variable: str, *default: str) -> Path:
    """An XDG folder: the variable's, which must be absolute to count, or one in the home."""
    named = os.environ.get(variable, "")
    if Path(named).is_absolute():
        return Path(named)
    try:
        return Path.home().joinpath(*default)
    except RuntimeError:
        raise InputError("$HOME", f"found no home folder, expected it or ${variable}") from None


def completion_script(parser: argparse.ArgumentParser, shell: str) -> str:
    """The script by which a shell completes the parser's commands, options, choices and files."""
    import shtab

    # How shtab completes a value: files, files of one suffix, or folders, where it is any.
    for action in _actions(parser):
        name = action.metavar or ""
        if name in _FOLDERS:
            action.complete = shtab.DIRECTORY
        # The value of --detector is a name or a file.
        elif name in _FILES or "--detector" in action.option_strings:
            action.complete = shtab.FILE
        elif suffix := PurePath(name).suffix:
            action.complete = shtab.glob(f"*{suffix}")
    return shtab.complete(parser, shell).rstrip("\n")


def _actions(parser: argparse.ArgumentParser) -> Iterator[Any]:
    """The options and arguments of a parser and of all its commands."""
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield from _actions(command)
