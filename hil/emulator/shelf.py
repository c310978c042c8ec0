"""The programs on the controller's disk, which the dashboard's `load` names and `play` runs."""

from __future__ import annotations

from pathlib import Path

from cell.errors import BackendError, ConfigError
from hil.emulator.interfaces import Program
from hil.emulator.programs import MAX_TEXT, recognise
from hil.emulator.urscript.urcap import EXTERNAL_CONTROL, UrCap

_ROOT = "/programs/"
"""Where a controller keeps them; clients may name it or leave it out."""


class Shelf:
    """Finds programs by name: `(name, host of the client) -> program`.

    One is always there: a node of the External Control URCap, set to the host that loads it.

    Args:
        folder: files of URScript text, called what `load` calls them; None: no such programs.

    Raises:
        ConfigError: there is no such folder.
    """

    def __init__(self, folder: Path | None = None) -> None:
        if folder is not None and not folder.is_dir():
            raise ConfigError(f"--programs: there is no folder {str(folder)!r}")
        self._folder = None if folder is None else folder.resolve()

    def __call__(self, name: str, host: str) -> Program:
        """The program, read anew each time.

        Raises:
            BackendError: there is none, or it cannot be run here.
        """
        name = name.removeprefix(_ROOT)
        if (file := self._file(name)) is not None:
            return recognise(_text(file), host)
        if name == EXTERNAL_CONTROL:
            return UrCap(name, host)
        raise BackendError(f"no program {name!r} on this controller")

    def _file(self, name: str) -> Path | None:
        """A file of the folder or below it, nothing that a name could climb to."""
        if self._folder is None:
            return None
        try:
            file = (self._folder / name).resolve()
            return file if file.is_relative_to(self._folder) and file.is_file() else None
        except (OSError, ValueError, RuntimeError):  # no name that a file can have
            return None


def _text(file: Path) -> str:
    try:
        if file.stat().st_size > MAX_TEXT:
            raise BackendError(f"{file}: a program may have {MAX_TEXT} bytes")
        return file.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise BackendError(f"{file}: no text of URScript can be read ({error})") from error
