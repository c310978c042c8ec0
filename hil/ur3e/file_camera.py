"""Recorded pictures instead of cameras: from an MCAP recording of a run, or from a folder of PNGs.

A folder holds one folder per camera, with pairs `color_NNNN.png` (8 bit) and `depth_NNNN.png` (16 bit,
millimetres), and if their times matter `times.txt` with one time in seconds per pair. Pictures come
with their original timing, the first of all at once; a request changes nothing about that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from cell.cameras import camera_pinhole
from cell.clock import WallClock
from cell.config import CellConfig
from cell.errors import BackendError, ConfigError, DecodeError
from cell.wire import codec
from cell.wire.pictures import COLOR_SUFFIX, COMPRESSED, DEPTH_SUFFIX, expand
from cell.wire.types import CameraInfo, Frame, Image
from hil.ur3e.rectify import check_size
from hil.ur3e.shutter import Grabber

if TYPE_CHECKING:
    from mcap.reader import McapReader

_MOST = 100_000
_RATE = 10.0
"""Pictures per second of a folder without times [Hz]."""
_NAP = 0.02
Picture = tuple[float, np.ndarray, np.ndarray]
"""Recorded time [s], colour (H, W, 3) uint8, depth (H, W) float32 [m]."""


class FileCamera:
    """See `hil.cameras.CameraSource`.

    Args:
        pictures: opens the recording at its beginning. begin: the recording's first time [s].
        start: shared by the cameras of one recording: when it began to be played.
    """

    def __init__(
        self,
        name: str,
        config: CellConfig,
        pictures: Callable[[], Iterator[Picture]],
        begin: float,
        start: Start,
    ) -> None:
        self.name = name
        self._config, self._pictures, self._begin, self._start = config, pictures, begin, start
        self._grabber: Grabber | None = None
        self._seq = 0

    def connect(self) -> None:
        if self._grabber is not None:
            return
        self._source = self._pictures()
        self._next: Picture | None = None
        self._shift = self._start.when() - self._begin
        self._grabber = Grabber(self.name, self._grab, self._start.clock)

    def info(self) -> CameraInfo:
        camera = self._config.cameras[self.name]
        p = camera_pinhole(camera)
        now = self._start.clock.now()
        return CameraInfo(now, f"camera_{self.name}", p.width, p.height, p.fx, p.fy, p.cx, p.cy)

    def request(self) -> None:
        """The next recorded picture comes when its time has come."""

    def take(self) -> list[Frame]:
        if self._grabber is None:
            raise BackendError(f"camera {self.name} is not connected; call connect() first")
        return self._grabber.take()

    def close(self) -> None:
        if self._grabber is not None:
            self._grabber.close()
            self._grabber = None

    def _grab(self) -> tuple[bool, Frame | None]:
        if self._next is None:
            self._next = next(self._source, None)
            if self._next is None:
                raise BackendError("the recording has ended")
        exposed = self._next[0] + self._shift
        due, clock = exposed + self._config.cameras[self.name].latency, self._start.clock
        if clock.now() < due:
            clock.sleep_until(min(due, clock.now() + _NAP))
            return True, None
        (_, rgb, depth), self._next = self._next, None
        check_size(self.name, self._config, rgb.shape[1], rgb.shape[0])
        self._seq += 1
        return True, Frame(self.name, self._seq, exposed, rgb, depth)


class Start:
    """When a recording began to be played: as its first camera was connected."""

    def __init__(self, clock: WallClock) -> None:
        self.clock = clock
        self._when: float | None = None

    def when(self) -> float:
        """[s], wall clock."""
        if self._when is None:
            self._when = self.clock.now()
        return self._when


def file_cameras(path: Path, config: CellConfig, clock: WallClock) -> dict[str, FileCamera]:
    """Cameras of a recording; raises `ConfigError` when it holds no pictures of theirs."""
    start = Start(clock)
    opener = _from_folder if path.is_dir() else _from_mcap
    openers = {name: opener(path, name) for name in config.cameras}
    begins = {}
    for name, pictures in openers.items():
        first = next(pictures(), None)
        if first is None:
            raise ConfigError(f"{path} holds no pictures of the camera '{name}'")
        begins[name] = first[0]
    begin = min(begins.values())
    return {name: FileCamera(name, config, openers[name], begin, start) for name in openers}


def _from_mcap(path: Path, camera: str) -> Callable[[], Iterator[Picture]]:
    def pictures() -> Iterator[Picture]:
        from mcap.exceptions import McapError
        from mcap.reader import make_reader

        colour: Image | None = None
        try:
            with path.open("rb") as file:
                reader = make_reader(file)
                topics = _topics(reader, camera)
                for schema, _, message in reader.iter_messages(topics) if topics else []:
                    packed = schema is not None and schema.name == COMPRESSED
                    image = expand(message.data) if packed else codec.decode(Image, message.data)
                    if image.pixels.ndim == 3:
                        colour = image
                    elif colour is not None and abs(colour.t - image.t) < 1e-6:
                        rgb, depth = np.asarray(colour.pixels, np.uint8), image.pixels
                        yield image.t, rgb, np.asarray(depth, np.float32)
        except (McapError, DecodeError, OSError) as error:
            raise ConfigError(f"{path} is no recording of this project: {error}") from None

    return pictures


def _topics(reader: McapReader, camera: str) -> list[str]:
    summary = reader.get_summary()
    color, depth = f"/camera/{camera}/color", f"/camera/{camera}/depth"
    ends = (color, depth, color + COLOR_SUFFIX, depth + DEPTH_SUFFIX)
    return [c.topic for c in summary.channels.values() if c.topic.endswith(ends)] if summary else []


def _from_folder(path: Path, camera: str) -> Callable[[], Iterator[Picture]]:
    folder = path / camera

    def pictures() -> Iterator[Picture]:
        names = sorted(p.name for p in folder.glob("color_*.png"))[:_MOST]
        times = _times(folder, len(names))
        for t, name in zip(times, names, strict=True):
            colour = cv2.imread(str(folder / name), cv2.IMREAD_COLOR)
            file = folder / name.replace("color_", "depth_")
            depth = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
            if colour is None or depth is None or depth.dtype != np.uint16 or depth.ndim != 2:
                raise ConfigError(f"{file}: needs an 8-bit colour and a 16-bit depth PNG of this number")
            if depth.shape != colour.shape[:2]:
                raise ConfigError(f"{file}: colour and depth differ in size")
            rgb = cv2.cvtColor(colour, cv2.COLOR_BGR2RGB)
            yield t, np.asarray(rgb, np.uint8), depth.astype(np.float32) * np.float32(1e-3)

    return pictures


def _times(folder: Path, count: int) -> list[float]:
    file = folder / "times.txt"
    if not file.exists():
        return [i / _RATE for i in range(count)]
    try:
        times = [float(word) for word in file.read_text().split()]
    except (OSError, ValueError) as error:
        raise ConfigError(f"{file}: one time in seconds per line: {error}") from None
    if len(times) != count or not np.isfinite(times).all() or (np.diff(times) < 0).any():
        raise ConfigError(f"{file}: needs {count} rising times, one per pair of pictures")
    return times
