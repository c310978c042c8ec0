"""The files of a calibration: the configuration to run with, the figures, and the board to print."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import yaml

from cell.calibrate.board import Board
from cell.calibrate.flow import Found
from cell.config import CellConfig, load, read_yaml
from cell.errors import ConfigError

_HEAD = "# Written by `cell calibrate`; run with `--config` and this file.\n"
_PIXELS = 32
"""Resolution at which the pattern is drawn, per square."""


def write(path: Path, base: Path | None, config: CellConfig, found: Sequence[Found]) -> None:
    """Write the overlay `base` with the calibrations in it, and check that it loads.

    Args:
        config: the cell that was calibrated; what is `simulated` of its cameras is kept, too.

    Raises:
        ConfigError: the file cannot be written.
    """
    data: dict[str, Any] = {} if base is None else read_yaml(base)
    cameras = data.setdefault("cameras", {})
    for one in found:
        camera = cameras.setdefault(one.name, {})
        camera["calibration"] = msgspec.to_builtins(one.record)
        if config.cameras[one.name].simulated is not None:
            camera["simulated"] = msgspec.to_builtins(config.cameras[one.name].simulated)
    _save(path, _HEAD + yaml.safe_dump(data, sort_keys=False, default_flow_style=None))
    load(path)


def figures(found: Sequence[Found]) -> dict[str, Any]:
    """Plain data: what was found, in mm, mrad, px and percent."""
    out: dict[str, Any] = {}
    for one in found:
        s = one.solution
        row: dict[str, Any] = {
            "views": s.views,
            "corners": s.corners,
            "residual_px": round(s.residual, 4),
            "moved_mm": round(one.moved[0] * 1e3, 3),
            "moved_mrad": round(one.moved[1] * 1e3, 3),
            "sd_mm": round(s.sd_position * 1e3, 3),
            "sd_mrad": round(s.sd_rotation * 1e3, 3),
            "sd_focal_percent": round(s.sd_focal * 100, 4),
            "sd_centre_px": round(s.sd_centre, 3),
        }
        if one.error is not None:
            row["error_mm"] = round(one.error.position * 1e3, 3)
            row["error_mrad"] = round(one.error.rotation * 1e3, 3)
            row["error_focal_percent"] = round(one.error.focal * 100, 4)
            row["error_centre_percent"] = round(one.error.centre * 100, 4)
        out[one.name] = row
    return out


def write_board(path: Path, config: CellConfig) -> None:
    """The board as an SVG of its true size, to print on paper or plate. Raises `ConfigError`."""
    board = Board(config.board)
    mm = config.board.square * 1e3 / _PIXELS
    margin = config.board.margin * config.board.square * 1e3
    dark = board.picture(_PIXELS) < 128
    height, width = dark.shape
    rows = []
    for v, row in enumerate(dark):
        edges = [0, *(u for u in range(1, width) if row[u] != row[u - 1]), width]
        for a, b in pairwise(edges):
            if row[a]:
                # a little higher than a row, so that no printer leaves white lines between them
                rows.append(
                    f'<rect x="{margin + a * mm:.4f}" y="{margin + v * mm:.4f}" '
                    f'width="{(b - a) * mm:.4f}" height="{mm * 1.02:.4f}"/>'
                )
    across, down = width * mm + 2 * margin, height * mm + 2 * margin
    _save(
        path,
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{across:.3f}mm" height="{down:.3f}mm" '
        f'viewBox="0 0 {across:.3f} {down:.3f}">\n'
        f'<rect width="100%" height="100%" fill="white" stroke="#bbb" stroke-width="0.2"/>\n'
        + "\n".join(rows)
        + "\n</svg>\n",
    )


def _save(path: Path, text: str) -> None:
    try:
        path.write_text(text)
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror}") from None
