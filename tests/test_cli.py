"""The command line as users meet it: quick help, and one plain line for every mistake."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

from cell.decision import policy

CELL = [sys.executable, "-m", "cell.cli"]


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def cell(*args: object, **env: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*CELL, *map(str, args)], capture_output=True, text=True, timeout=60, env={**os.environ, **env}
    )


def nodes(port: int) -> list[int]:
    """Process ids of simulation nodes on a port (their configuration came by standard input)."""
    out = []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            command = (entry / "cmdline").read_bytes().split(b"\0")
            if (
                b"hil" in command
                and b"-m" in command
                and f"CELL_TEST={port}".encode() in (entry / "environ").read_bytes().split(b"\0")
            ):
                out.append(int(entry.name))
        except OSError:
            continue
    return out


def overlay(folder: Path, text: str = "", port: int | None = None) -> tuple[Path, int]:
    """A configuration file with a port of its own."""
    port = port or free_port()
    file = folder / "own.yaml"
    file.write_text(f"port: {port}\n{text}")
    return file, port


def refused(folder: Path, *args: object, config: str = "", **env: str) -> str:
    """The one line that `cell run` answers bad input with."""
    file, port = overlay(folder, config)
    run = cell("run", "--headless", "--onions", 1, "--config", file, *args, CELL_TEST=str(port), **env)
    assert run.returncode == 2, run.stderr
    assert run.stdout == ""
    lines = run.stderr.splitlines()
    assert len(lines) == 1 and lines[0].startswith("cell: "), run.stderr
    assert "Traceback" not in run.stderr
    assert nodes(port) == []
    return lines[0]


# -- help -----------------------------------------------------------------------------------------------


def test_help_names_the_commands_and_disclaims_safety() -> None:
    run = cell("--help", COLUMNS="200")
    assert run.returncode == 0 and run.stderr == ""
    said = " ".join(run.stdout.split())
    assert "run" in said and "doctor" in said and "Not a safety-rated system" in said
    run_help = cell("run", "--help", COLUMNS="200")
    for option in (
        "--backend",
        "--policy",
        "--onions",
        "--seed",
        "--headless",
        "--json",
        "--record",
        "--config",
    ):
        assert option in run_help.stdout, option


def test_help_imports_nothing_slow() -> None:
    code = (
        "import sys; sys.argv = ['cell', '--help']\n"
        "from cell.cli import main\n"
        "try: main()\nexcept SystemExit: pass\n"
        "import json; print(json.dumps(sorted({m.split('.')[0] for m in sys.modules})))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30, check=True)
    loaded = set(json.loads(run.stdout.splitlines()[-1]))
    slow = {"torch", "toppra", "yourdfpy", "scipy", "numpy", "cv2", "pybullet", "onnxruntime", "zenoh", "hil"}
    assert not loaded & slow


def test_version() -> None:
    from cell import __version__

    assert cell("--version").stdout == f"cell {__version__}\n"


# -- mistakes -------------------------------------------------------------------------------------------


def test_a_policy_that_is_missing_incomplete_or_garbled(tmp_path: Path) -> None:
    good = policy.shipped()["expert"].read_text().splitlines()
    for name, content, words in [
        ("none.csv", None, "No such file"),
        ("lacking.csv", "\n".join(good[:-1]), "no row for"),
        (
            "garbled.csv",
            "\n".join([*good[:5], good[5].replace(good[5].split(",")[6], "dance"), *good[6:]]),
            "line 6",
        ),
        ("bytes.csv", b"\xff\x00\xfe\x80", "not a text file"),
    ]:
        path = tmp_path / str(name)
        if content is not None:
            path.write_bytes(content if isinstance(content, bytes) else content.encode())
        said = refused(tmp_path, "--policy", path)
        assert str(words) in said and path.stem in said, said


def test_options_out_of_range(tmp_path: Path) -> None:
    for args, words in [
        (("--onions", 0), "--onions must be from 1 to 15, got 0"),
        (("--onions", 16), "--onions must be from 1 to 15, got 16"),
        (("--seed", -1), "--seed"),
        (("--backend", "kuka"), "--backend: got 'kuka'; legal values: sim"),
        (("--json", tmp_path / "no" / "r.json"), "does not exist"),
        (("--record", tmp_path / "no" / "r.mcap"), "does not exist"),
    ]:
        assert words in refused(tmp_path, *args)


def test_wrong_words_are_answered_by_the_option_parser() -> None:
    for args in (("run", "--onions", "many"), ("run", "--colour", "red"), ("sort",)):
        run = cell(*args)
        assert run.returncode == 2 and "Traceback" not in run.stderr and run.stderr


def test_files_that_could_not_be_written_are_refused_before_the_round(tmp_path: Path) -> None:
    """Nobody should wait for a round to learn that its result cannot be kept."""
    assert "is a folder" in refused(tmp_path, "--json", tmp_path)
    notes = tmp_path / "notes.mcap"
    notes.write_text("not a recording")
    assert ".mcap" in refused(tmp_path, "--record", tmp_path / "r.bag")
    assert "not replaced" in refused(tmp_path, "--record", notes)


def test_a_configuration_that_cannot_be_used(tmp_path: Path) -> None:
    for text, words in [
        ("colour: red\n", "unknown key 'colour'"),
        ("bin: {center: [0.0, 1.5, -0.1]}\n", "bin.center"),
        ("onions: {spacing: 0.5}\n", "9 onions do not fit"),
        ("detector: /nonexistent/w.safetensors\n", "detector weights /nonexistent/w.safetensors are missing"),
    ]:
        args = ("--onions", 9) if "spacing" in text else ()
        assert words in refused(tmp_path, *args, config=text)
    assert "No such file" in refused(tmp_path, "--config", tmp_path / "none.yaml")


def test_a_port_that_is_taken(tmp_path: Path) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        file, _ = overlay(tmp_path, port=port)
        run = cell("run", "--headless", "--onions", 1, "--config", file, CELL_TEST=str(port))
    assert run.returncode == 2 and len(run.stderr.splitlines()) == 1, run.stderr
    assert f"port {port} is in use" in run.stderr and "'port:'" in run.stderr
    assert nodes(port) == []


def test_a_renderer_that_cannot_work_here(tmp_path: Path) -> None:
    """A machine without EGL drivers, made by hiding their registry."""
    said = refused(tmp_path, config="renderer: gl\n", **NO_EGL)
    assert "EGL" in said and "apt-get install" in said


NO_EGL = {"__EGL_VENDOR_LIBRARY_DIRS": "/nonexistent", "__EGL_VENDOR_LIBRARY_FILENAMES": "/nonexistent"}


# -- doctor ---------------------------------------------------------------------------------------------


def test_the_doctor_finds_this_machine_well_and_names_what_is_missing(tmp_path: Path) -> None:
    file, _ = overlay(tmp_path)
    well = cell("doctor", "--config", file)
    assert well.returncode == 0, well.stdout
    assert all(
        word in well.stdout for word in ("python", "packages", "reach", "detector", "port", "renderer")
    )
    file, _ = overlay(tmp_path, "detector: /nonexistent/w.safetensors\n")
    ill = cell("doctor", "--config", file, COLUMNS="300", **NO_EGL)
    assert ill.returncode == 1 and "Traceback" not in ill.stderr
    assert "MISS detector" in ill.stdout and "warn renderer" in ill.stdout
