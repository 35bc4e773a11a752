"""Send models that many tasks need to each machine once, identified by their hash."""

from __future__ import annotations

import hashlib
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.files import whole_file


@dataclass(frozen=True)
class Parcel:
    """A file that everybody gets once: where all can read it, and the hash that it is known by."""

    source: Path
    sha256: str

    def here(self) -> Path:
        """The file on this machine's own disk; fetched by the first task that asks for it.

        Raises
        ------
        InputError
            What stands at the source is not what was sent.
        """
        target = local_folder() / f"{self.sha256}{self.source.suffix}"
        if not target.exists():
            content = self.source.read_bytes()
            if hashlib.sha256(content).hexdigest() != self.sha256:
                raise InputError(f"{self.source}: has changed since the fleet was started")
            with whole_file(target) as temporary:
                temporary.write_bytes(content)
        return target


def local_folder() -> Path:
    """Folder of models on this machine; it must belong to the user, since the models are executed.

    Raises
    ------
    InputError
        The folder belongs to somebody else.
    """
    folder = Path(tempfile.gettempdir()) / f"aero-bayes-models-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if found.st_uid != os.getuid() or folder.is_symlink() or found.st_mode & 0o022:
        raise InputError(f"{folder}: expected a folder that only this user can write to")
    return folder
