"""Which version of the code this is: the stamp on every result."""

from __future__ import annotations

import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path


def code_version() -> str:
    """Version of the installed package, or "unknown"."""
    try:
        return version("sorting-cell")
    except PackageNotFoundError:
        return "unknown"


def commit() -> str:
    """Short commit of the checkout that holds this file, with "+" when it has changes; or "unknown"."""
    folder = Path(__file__).resolve().parent
    try:
        out = subprocess.run(
            ["git", "-C", str(folder), "describe", "--always", "--dirty=+", "--abbrev=12"],
            capture_output=True,
            text=True,
            timeout=5,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return out.stdout.strip()
