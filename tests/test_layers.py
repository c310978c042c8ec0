"""The architecture's rules, held by reading the source: imports, the clock, pickle."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
BASE = {
    "cell.wire",
    "cell.child",
    "cell.clock",
    "cell.frames",
    "cell.config",
    "cell.settings",
    "cell.settings_ur3e",
    "cell.cameras",
    "cell.limits",
    "cell.errors",
    "cell.version",
}
ABOVE = {
    # package: what of the project it may import besides itself and the base
    "cell.perception": set(),
    "cell.motion": set(),
    "cell.record": {"cell.decision.io", "cell.perception", "urdf"},
    "cell.decision": {"cell.perception", "cell.motion"},
    "cell.run": {"cell.decision", "cell.perception", "cell.motion", "cell.record"},
    "cell.replay": {"cell.decision", "cell.perception", "cell.motion", "cell.record"},
    "cell.calibrate": {"cell.run", "cell.decision", "cell.perception", "cell.motion"},
    "cell.doctor": {"cell.perception", "cell.motion"},
    "cell.view": {"cell.decision.policy", "cell.perception", "cell.motion", "cell.record", "urdf"},
    "cell.learn": {"cell.decision.policy"},
    "cell.trials": {
        "cell.run",
        "cell.decision",
        "cell.perception",
        "cell.motion",
        "cell.record",
        "cell.learn",
    },
    "hil": {"urdf"},
    "urdf": set(),
}
FILES = sorted(p for top in ("cell", "hil", "urdf") for p in (ROOT / top).rglob("*.py"))


def imports(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            yield node.module


def module(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def within(name: str, packages: set[str]) -> bool:
    return any(name == p or name.startswith(p + ".") for p in packages)


@pytest.mark.parametrize("path", FILES, ids=module)
def test_imports_run_one_way(path: Path) -> None:
    name = module(path)
    if name == "cell.cli" or name == "cell":
        return
    ours = [i for i in imports(path) if i.split(".")[0] in ("cell", "hil", "urdf")]
    if within(name, BASE):
        allowed = BASE
    else:
        top = next(p for p in ABOVE if within(name, {p}))
        allowed = BASE | ABOVE[top] | {top}
    wrong = [i for i in ours if not within(i, allowed)]
    assert not wrong, f"{name} may import only {sorted(allowed)}; it imports {wrong}"


@pytest.mark.parametrize("path", FILES, ids=module)
def test_time_is_read_in_one_place(path: Path) -> None:
    if module(path) == "cell.clock":
        return
    assert "time" not in set(imports(path)), "use cell.clock"
    text = path.read_text()
    assert "datetime.now" not in text and "utcnow" not in text


@pytest.mark.parametrize("path", FILES, ids=module)
def test_nothing_unpickles(path: Path) -> None:
    assert not {"pickle", "dill", "joblib", "shelve"} & set(imports(path))
    assert "allow_pickle=True" not in path.read_text()
    assert "torch.load" not in path.read_text()


@pytest.mark.parametrize("path", FILES, ids=module)
def test_modules_have_one_job(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= 330
    assert ast.get_docstring(ast.parse(path.read_text())) or not path.read_text().strip()
