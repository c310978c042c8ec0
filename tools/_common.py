"""What every benchmark prints beside its figures, so that a number can be traced."""

from __future__ import annotations

import os
import platform
from pathlib import Path
from typing import Any

from cell.version import commit


def provenance(seed: int | None = None) -> dict[str, Any]:
    """Seed, commit and machine."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        names = [
            line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if "model name" in line
        ]
        model = names[0] if names else model
    return {
        "seed": seed,
        "commit": commit(),
        "machine": {
            "cpu": model,
            "cores": os.cpu_count(),
            "system": f"{platform.system()} {platform.release()}",
            "python": platform.python_version(),
            "load": [round(v, 2) for v in os.getloadavg()],
        },
    }
