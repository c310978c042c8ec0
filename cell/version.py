"""Which version of the code this is: the stamp on every result."""

from __future__ import annotations

import platform
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


def machine() -> str:
    """Processor and numerical libraries: between two of them, last bits of results may differ."""
    model = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next(
            (line.partition(":")[2].strip() for line in lines if line.startswith("model name")), model
        )
    except OSError:
        pass
    found = []
    for name in ("numpy", "scipy", "opencv-python-headless", "onnxruntime"):
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            found.append(f"{name} unknown")
    return f"{model}, {', '.join(found)}"
