"""A cache of files for later runs, in a folder that only its user can write to.

INPUTS: a folder, a name, a key and bytes. OUTPUTS: the same bytes later on, or None: whatever was
changed, cut off, exchanged or put there by another user is not read, and can be made again.
"""

import hashlib
import os
import stat
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from jaxmocap.formats.files.errors import FileError
from jaxmocap.formats.files.reading import read_bytes
from jaxmocap.formats.files.writing import replacing

# The file's first bytes: what it is, and which layout it has. A SHA-256 of key and content follows,
# then the content.
MAGIC = b"jaxmocap kept 1\n"
SEAL_BYTES = len(MAGIC) + hashlib.sha256().digest_size
# Of folders and files: nobody else reads or writes them.
FOLDER_MODE = 0o700
FILE_MODE = 0o600


class PrivateCache:
    """A folder of sealed files.

    Attributes:
        folder: that holds the files.
    """

    def __init__(self, root: Path, name: str, warn: Callable[[str], None] = lambda _: None):
        """Nothing is made yet.

        Args:
            root: a folder that was chosen by the user.
            name: of the folder in it.
            warn: called with a sentence where another user could have written.
        """
        self.folder, self._root, self._warn = root / name, root, warn

    def read(self, name: str, key: str) -> bytes | None:
        """What was written by that name and that key; None if it is not there or damaged."""
        path = self.folder / name
        if not self._is_own(self._root, self.folder, path):
            return None
        try:
            sealed = read_bytes(path)
        except FileError:
            return None
        seal, content = sealed[:SEAL_BYTES], sealed[SEAL_BYTES:]
        return content if seal == _seal(key, content) else None

    def write(self, name: str, key: str, content: bytes) -> None:
        """Keep bytes, in place of whatever has the name; nothing where that cannot be."""
        try:
            self.make_folder()
            if self._is_own(self._root, self.folder):
                with replacing(self.folder / name) as temporary:
                    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
                    with open(os.open(temporary, flags, FILE_MODE), "wb") as file:
                        file.write(_seal(key, content) + content)
        # A folder that cannot be written to keeps nothing.
        except (OSError, FileError):
            pass

    def make_folder(self) -> None:
        """Make the folder where there is none yet, for its user alone."""
        with suppress(OSError):
            for folder in (self._root, self.folder):
                folder.mkdir(FOLDER_MODE, parents=True, exist_ok=True)

    def _is_own(self, *paths: Path) -> bool:
        """Whether nobody else could have written there; else a sentence says so."""
        for path in paths:
            if (problem := others_can_write(path)) is not None:
                self._warn(f"{path}: {problem}")
                return False
        return True


def others_can_write(path: Path) -> str | None:
    """Why another user may have written to a file or folder, and what to do; None if none may."""
    if not hasattr(os, "geteuid"):
        return None
    try:
        status = os.stat(path)
    except OSError:
        return None
    elsewhere = "set JAX_COMPILATION_CACHE_DIR to a folder of your own"
    if status.st_uid != os.geteuid():
        return f"belongs to another user, so no compiled program is read from there; {elsewhere}"
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return (
            f"others can write to it, so no compiled program is read from there; chmod go-w, or "
            f"{elsewhere}"
        )
    return None


def _seal(key: str, content: bytes) -> bytes:
    """What a file begins with: another key's content has another seal."""
    digest = hashlib.sha256(hashlib.sha256(key.encode()).digest())
    digest.update(content)
    return MAGIC + digest.digest()
