"""Configuration: strict, typed, and every complaint names the key."""

from __future__ import annotations

import ast
import inspect
from pathlib import Path
from typing import Any

import msgspec
import pytest
import yaml

import cell.config
import cell.settings
from cell.config import CellConfig, from_dict, load, reference_cell, to_dict
from cell.errors import ConfigError


def refused(tmp_path: Path, text: str) -> str:
    """What `load` says about an overlay file; always one line."""
    file = tmp_path / "own.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load(file)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_the_reference_cell_loads() -> None:
    config = load()
    assert config == from_dict(yaml.safe_load(reference_cell().read_text()))
    assert from_dict(to_dict(config)) == config


def test_an_overlay_changes_what_it_names_and_nothing_else(tmp_path: Path) -> None:
    file = tmp_path / "own.yaml"
    file.write_text("port: 7999\nmotion: {hover: 0.12}\ncameras: {belt: {rate: 15}}\n")
    before, after = to_dict(load()), to_dict(load(file))
    assert (after["port"], after["motion"]["hover"], after["cameras"]["belt"]["rate"]) == (7999, 0.12, 15)
    after["port"], after["motion"]["hover"] = before["port"], before["motion"]["hover"]
    after["cameras"]["belt"]["rate"] = before["cameras"]["belt"]["rate"]
    assert after == before


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("colour: red", ["'colour'", "belt", "port", "renderer"]),
        ("arm: {lagg: 0.1}", ["'arm.lagg'", "lag", "home"]),
        ("cameras: {belt: {widht: 3}}", ["'cameras.belt.widht'", "width"]),
        ("arm: 3", ["'arm'", "section"]),
        ("arm:", ["'arm'", "section"]),
        ("arm: {lag: slow}", ["arm.lag", "float"]),
        ("arm: {home: [0, 0]}", ["arm.home", "6"]),
        ("port: 7447.5", ["port", "int"]),
        ("belt: {pick_x: [0.1, 0.2, 0.3]}", ["belt.pick_x", "2"]),
        ("cameras: {wrist: {width: 640}}", ["cameras", "position"]),
        ("12: 5", ["'12'"]),
    ],
)
def test_wrong_keys_and_types_are_named(tmp_path: Path, text: str, words: list[str]) -> None:
    said = refused(tmp_path, text)
    assert all(word in said for word in words), said


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("port: 80", "port"),
        ("port: 70000", "port"),
        ("name: a/b", "name"),
        ("renderer: vulkan", "renderer"),
        ("arm: {control_period: 0}", "arm.control_period"),
        ("arm: {control_period: .inf}", "arm.control_period"),
        ("arm: {physics_substeps: 0}", "arm.physics_substeps"),
        ("arm: {lag: -0.1}", "arm.lag"),
        ("arm: {lag: .nan}", "arm.lag"),
        ("arm: {max_acceleration: -8}", "arm.max_acceleration"),
        ("arm: {velocity_scale: 1.5}", "arm.velocity_scale"),
        ("arm: {home: [.nan, 0, 0, 0, 0, 0]}", "arm.home"),
        ("belt: {x: [0.6, 0.2]}", "belt.x"),
        ("belt: {pick_y: [-2.0, 0.0]}", "belt.pick_y"),
        ("bin: {size: [0.26, 0.24, -0.2]}", "bin.size"),
        ("bin: {center: [.inf, 0, 0]}", "bin.center"),
        ("gripper: {stroke: -0.1}", "gripper.stroke"),
        ("gripper: {min_force: 300}", "gripper.min_force"),
        ("gripper: {grip_force: 1000}", "gripper.grip_force"),
        ("gripper: {grip_speed: 0}", "gripper.grip_speed"),
        ("cameras: {belt: {width: 0}}", ".width"),
        ("cameras: {belt: {height: 100000}}", ".height"),
        ("cameras: {belt: {hfov: 4}}", ".hfov"),
        ("cameras: {belt: {target: [0.08, -0.40, 0.0]}}", "cameras.belt.target"),
        ("cameras: {belt: {min_depth: 5}}", "cameras.belt.min_depth"),
        ("cameras: {belt: {depth_unit: 0}}", ".depth_unit"),
        ("cameras: {belt: {depth_baseline: 0}}", ".depth_baseline"),
        ("cameras: {belt: {latency: -1}}", ".latency"),
        ("onions: {diameter: [0.08, 0.06]}", "onions.diameter"),
        ("onions: {blemished_share: 1.2}", "onions.blemished_share"),
        ("onions: {spacing: 0.01}", "onions.spacing"),
        ("motion: {collaborative_speed: 0}", "collaborative_speed"),
        ("motion: {industrial_speed: 0.1}", "industrial_speed"),
        ("motion: {speed_margin: 0}", "motion.speed_margin"),
        ("motion: {hover: -1}", "motion.hover"),
        ("supervisor: {ticks_per_cycle: 0}", "supervisor.ticks_per_cycle"),
        ("supervisor: {heartbeat_deadline: 0}", "supervisor.heartbeat_deadline"),
        ("supervisor: {grasp_attempts: 0}", "supervisor.grasp_attempts"),
        ("supervisor: {look_attempts: 0}", "supervisor.look_attempts"),
        ("supervisor: {score_threshold: 2}", "supervisor.score_threshold"),
        ("supervisor: {round_timeout: .nan}", "supervisor.round_timeout"),
    ],
)
def test_impossible_values_are_refused(tmp_path: Path, text: str, key: str) -> None:
    assert key in refused(tmp_path, text)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("arm: [", "not valid YAML"),
        ("- a\n- b\n", "mapping"),
        ("", "mapping"),
        ("arm: {lag: 0.1}\narm: {lag: 0.2}\n", "'arm'"),
    ],
)
def test_garbled_files(tmp_path: Path, text: str, words: str) -> None:
    assert words in refused(tmp_path, text)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "bytes.yaml").write_bytes(b"\xff\xfe\x00\x80")
    (tmp_path / "deep.yaml").write_text("[" * 3000)
    for name, words in [
        ("none.yaml", "No such file"),
        ("", "directory"),
        ("bytes.yaml", "text"),
        ("deep.yaml", "valid YAML"),
    ]:
        with pytest.raises(ConfigError, match=words) as caught:
            load(tmp_path / name)
        assert "\n" not in str(caught.value)


def test_every_key_has_a_docstring_of_its_own_or_shares_the_next_ones() -> None:
    """A run of keys ends in a docstring; classes and their sections are documented too."""
    classes: list[Any] = [c for c in vars(cell.config).values() if inspect.isclass(c)]
    sections = [c for c in classes if issubclass(c, msgspec.Struct) and c.__name__.endswith("Config")]
    assert CellConfig in sections and len(sections) == 14
    sections_by_name = {c.__name__ for c in sections}
    trees = [ast.parse(inspect.getsource(module)) for module in (cell.config, cell.settings)]
    for node in (node for tree in trees for node in tree.body):
        if not isinstance(node, ast.ClassDef) or node.name not in sections_by_name:
            continue
        assert ast.get_docstring(node), node.name
        pending: list[str] = []
        for item in node.body[1:]:
            if isinstance(item, ast.AnnAssign):
                section = isinstance(item.annotation, (ast.Name, ast.Subscript)) and "Config" in ast.dump(
                    item.annotation
                )
                pending += [] if section else [ast.unparse(item.target)]
            elif isinstance(item, ast.Expr):
                pending = []
        assert not pending, f"{node.name}: no docstring after {pending}"
