"""Writes docs/commands.md and docs/configuration.md from the program itself; see tools/docs."""

from __future__ import annotations

import ast
import inspect
import sys
from pathlib import Path
from typing import Any, get_args

import msgspec
import typer
import yaml

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from cell.cli import app  # noqa: E402
from cell.config import CellConfig, reference_cell  # noqa: E402

_NOTE = "<!-- Written by tools/docs from the program; change the program's own texts instead. -->\n\n"


def pages() -> dict[Path, str]:
    """The two pages: path and text."""
    docs = ROOT / "docs"
    return {docs / "commands.md": commands(), docs / "configuration.md": configuration()}


# -- commands -----------------------------------------------------------------------------------------------


def commands() -> str:
    """Every verb with its arguments and options."""
    out = [
        "# Commands\n\n" + _NOTE,
        "Exit codes: 0 it worked, 1 it ran and failed, 2 bad input (one line says what), 130 interrupted.\n",
    ]
    for words, command in verbs():
        text = inspect.cleandoc(command.help or "").strip()
        out.append(f"\n## cell {' '.join(words)}\n\n{text}\n")
        rows = [row for p in command.params if (row := _parameter(p)) is not None]
        if rows:
            out.append("\n| option | default | meaning |\n|---|---|---|\n" + "".join(rows))
    return "".join(out)


def verbs() -> list[tuple[tuple[str, ...], Any]]:
    """(words, command) of everything that can be typed after `cell`, groups that do something included."""
    found: list[tuple[tuple[str, ...], Any]] = []

    def walk(words: tuple[str, ...], command: Any) -> None:
        children = getattr(command, "commands", {})
        if words and (not children or getattr(command, "invoke_without_command", False)):
            found.append((words, command))
        for name, child in children.items():
            walk((*words, name), child)

    walk((), typer.main.get_command(app))
    return found


def _parameter(p: Any) -> str | None:
    if p.name == "help":
        return None
    names = ", ".join(f"`{o}`" for o in [*p.opts, *p.secondary_opts]) if p.opts[0].startswith("-") else ""
    names = names or f"`{p.name.upper()}`"
    default = p.default() if callable(p.default) else p.default
    shown = "" if default is None or default is False or default in ("", (), []) else f"`{default}`"
    required = "required" if p.required else shown
    meaning = " ".join((getattr(p, "help", None) or "").split()).replace("|", "\\|")
    return f"| {names} | {required} | {meaning} |\n"


# -- configuration ------------------------------------------------------------------------------------------


def configuration() -> str:
    """Every key with its value in the reference cell."""
    reference = yaml.safe_load(reference_cell().read_text())
    out = [
        "# Configuration\n\n" + _NOTE,
        "`--config mine.yaml` lays a file over the reference cell, `urdf/cell.yaml`; write only what "
        "differs. Unknown keys, wrong types and impossible values are errors that name the key. Lengths are "
        "in metres, angles in radians, times in seconds, positions in the frame of the robot's base (x "
        "towards the belt, z up). The values are those of the reference cell.\n\n```yaml\nport: 7450\n"
        "motion:\n  collaborative_speed: 0.20\ncameras:\n  belt: {rate: 5.0}\n```\n",
    ]
    for where, section in sections():
        out.append(f"\n## {where or 'top level'}\n\n{inspect.cleandoc(section.__doc__ or '')}\n\n")
        values = _at(reference, where)
        texts = _texts(section)
        rows = []
        for field in msgspec.structs.fields(section):
            if _section_of(field.type) is None:
                rows.append(f"| `{field.name}` | {_value(values, field)} | {texts[field.name]} |\n")
        if rows:
            out.append("| key | value | meaning |\n|---|---|---|\n" + "".join(rows))
    return "".join(out)


def sections() -> list[tuple[str, type]]:
    """(dotted key, class) of every section; `<name>` stands for a camera's name."""
    found: list[tuple[str, type]] = []

    def walk(where: str, section: type) -> None:
        found.append((where, section))
        for field in msgspec.structs.fields(section):
            child = _section_of(field.type)
            if child is not None:
                name = f"{field.name}.<name>" if "dict" in str(field.type) else field.name
                walk(f"{where}.{name}" if where else name, child)

    walk("", CellConfig)
    return found


def _section_of(kind: Any) -> type | None:
    """The section class in a field's type, if there is one."""
    for candidate in (kind, *get_args(kind)):
        if isinstance(candidate, type) and issubclass(candidate, msgspec.Struct):
            return candidate
    return None


def _texts(section: type) -> dict[str, str]:
    """What the source says of each key, its parents' included; keys in a row share the text after them."""
    tree = ast.parse(inspect.getsource(sys.modules[section.__module__]))
    classes = {n.name: n for n in tree.body if isinstance(n, ast.ClassDef)}
    own = [classes[c.__name__] for c in section.__mro__ if c.__name__ in classes]
    body = [item for c in reversed(own) for item in c.body[1:]]
    texts: dict[str, str] = {}
    waiting: list[str] = []
    for item in body:
        if isinstance(item, ast.AnnAssign):
            waiting.append(ast.unparse(item.target))
        elif isinstance(item, ast.Expr) and isinstance(item.value, ast.Constant):
            text = " ".join(str(item.value.value).split()).replace("|", "\\|")
            texts.update(dict.fromkeys(waiting, text))
            waiting = []
    return {field.name: texts.get(field.name, "") for field in msgspec.structs.fields(section)}


def _at(reference: dict[str, Any], where: str) -> list[Any]:
    """The reference cell's values of a section; one per camera for `<name>`."""
    found: list[Any] = [reference]
    for name in where.split(".") if where else ():
        found = [
            v
            for part in found
            if isinstance(part, dict)
            for v in (part.values() if name == "<name>" else [part.get(name)])
        ]
    return [part for part in found if isinstance(part, dict)]


def _value(values: list[Any], field: Any) -> str:
    shown = [part[field.name] for part in values if field.name in part]
    if not shown:
        if field.default is msgspec.NODEFAULT or field.default is None:
            return ""
        shown = [field.default]
    texts = [
        f"`{yaml.safe_dump(v, default_flow_style=True).strip().removesuffix('...').strip()}`"
        for v in map(_plain, shown)
    ]
    return ", ".join(dict.fromkeys(texts))


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


if __name__ == "__main__":
    for path, text in pages().items():
        path.write_text(text)
        print(f"written: {path.relative_to(ROOT)}")
