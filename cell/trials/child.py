"""`python -m cell.trials.child`: one round in a process of its own.

Reads a job as one line of JSON from standard input and writes the round's files into the folder
given as its argument. Ends at once, and with it everything it started, when standard input closes:
its parent is gone. Deliberate errors are one line on standard error and exit code 2.
"""

from __future__ import annotations

import os
import sys
import threading
from pathlib import Path

from cell.errors import CellError
from cell.trials.one_round import RESULT, job_from_json, run_job


def main() -> int:
    """Run the job; returns the exit code."""
    job = job_from_json(sys.stdin.readline())
    threading.Thread(target=_watch_parent, daemon=True).start()
    folder = Path(sys.argv[1])
    try:
        files = run_job(job)
    except CellError as error:
        print(f"cell: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    for ending, content in sorted(files.items(), key=lambda item: item[0] == RESULT):
        (folder / f"round.{ending}").write_bytes(content)
    return 0


def _watch_parent() -> None:
    while sys.stdin.readline():
        pass
    os._exit(3)  # the node reads our pipe's end as its own end and stops the arm


if __name__ == "__main__":
    sys.exit(main())
