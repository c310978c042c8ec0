"""Puts the hand networks in place; run once at set-up: python -m cell.perception.hands.fetch.

The wheel `mediapipe==0.10.21` is downloaded by pip (pinned by SHA-256, without its
dependencies, never installed) and the network files are read out of it.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import zipfile
import zlib
from pathlib import Path

from cell.errors import CellError
from cell.perception.hands.models import (
    MODELS,
    HandModelError,
    ModelFile,
    cache_dir,
    mismatch,
    read_model,
)

_WHEEL = "mediapipe==0.10.21"
_WHEEL_SHA256 = "05dc4a9e593655a79558d05d6227d31018c2537a4bd3362b51e230cf22aecfe3"
_PLATFORM = ("--platform", "manylinux_2_28_x86_64", "--python-version", "3.11", "--implementation", "cp")
"""One wheel for every machine: the networks in it do not depend on the platform."""
_PIP_TIMEOUT = 600.0
"""Longest time for the download of 36 MB [s]."""


def fetch(folder: Path | None = None, wheel: Path | None = None) -> Path:
    """Make sure that all network files are in `folder` and right; downloads only if they are not.

    Args:
        folder: where to put them; the cache directory if None.
        wheel: a copy of the wheel to use instead of downloading it.

    Returns:
        The folder.

    Raises:
        HandModelError: the download failed, or the wheel does not hold the expected files.
    """
    target = folder or cache_dir()
    if _complete(target):
        return target
    if wheel is not None:
        _extract_all(wheel, target)
    else:
        with tempfile.TemporaryDirectory(prefix="hand-networks-") as scratch:
            _extract_all(_download(Path(scratch)), target)
    return target


def _complete(folder: Path) -> bool:
    try:
        for model in MODELS:
            read_model(model, folder)
    except HandModelError:
        return False
    return True


def _download(folder: Path) -> Path:
    wanted = folder / "wanted.txt"
    wanted.write_text(f"{_WHEEL} --hash=sha256:{_WHEEL_SHA256}\n")
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check"]
    command += ["--no-deps", "--only-binary=:all:", "--require-hashes", *_PLATFORM]
    command += ["--dest", str(folder), "--requirement", str(wanted)]
    remedy = "check the network, or download the wheel elsewhere and give it with --wheel FILE"
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_PIP_TIMEOUT, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise HandModelError(f"pip download of {_WHEEL} did not finish ({error}); {remedy}") from None
    wheels = sorted(folder.glob("*.whl"))
    if done.returncode != 0 or len(wheels) != 1:
        reason = " ".join(done.stderr.split())[-300:]
        raise HandModelError(f"pip download of {_WHEEL} failed ({reason}); {remedy}")
    return wheels[0]


def _extract_all(wheel: Path, folder: Path) -> None:
    try:
        with zipfile.ZipFile(wheel) as archive:
            files = [(model, _read_member(archive, model)) for model in MODELS]
    except (OSError, zipfile.BadZipFile) as error:
        raise HandModelError(f"{wheel} cannot be read as a wheel ({error}); expected {_WHEEL}") from None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for model, data in files:
            _write_whole(folder / model.name, data)
    except OSError as error:
        raise HandModelError(f"hand networks cannot be written to {folder} ({error.strerror})") from None


def _read_member(archive: zipfile.ZipFile, model: ModelFile) -> bytes:
    """One file of the wheel, by its exact name, read no further than its known size."""
    try:
        with archive.open(model.member) as file:
            data = file.read(model.size + 1)
    except (KeyError, RuntimeError, NotImplementedError, EOFError, zlib.error) as error:
        raise HandModelError(
            f"the wheel has no readable {model.member} ({error}); expected {_WHEEL}"
        ) from None
    problem = mismatch(model, data)
    if problem:
        raise HandModelError(f"{model.member} in the wheel: {problem}; expected {_WHEEL}")
    return data


def _write_whole(path: Path, data: bytes) -> None:
    """Write so that nobody ever sees half a file, even if two programs do it at once."""
    handle, name = tempfile.mkstemp(prefix=path.name, dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        os.chmod(name, 0o644)
        os.replace(name, path)
    except OSError:
        Path(name).unlink(missing_ok=True)
        raise


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code, 0 or 2."""
    parser = argparse.ArgumentParser(prog="python -m cell.perception.hands.fetch", description=fetch.__doc__)
    parser.add_argument("--into", type=Path, default=None, help="folder; default: the cache")
    parser.add_argument("--wheel", type=Path, default=None, help=f"a copy of {_WHEEL} instead of a download")
    args = parser.parse_args(arguments)
    try:
        print(fetch(args.into, args.wheel))
    except CellError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
