"""The documentation: the reference is the program's own, pages are in the site, links lead somewhere."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
sys.path.insert(0, str(ROOT / "tools"))

import _reference  # noqa: E402

PAGES = sorted(DOCS.glob("*.md"))


def test_every_command_and_option_is_documented() -> None:
    text = (DOCS / "commands.md").read_text()
    assert text == _reference.commands(), (
        "run tools/docs (or python tools/_reference.py) and commit docs/commands.md"
    )
    for words, command in _reference.verbs():
        assert f"## cell {' '.join(words)}\n" in text and (command.help or "").strip(), words
        for option in command.params:
            assert option.name == "help" or (getattr(option, "help", "") or "").strip(), (words, option.name)


def test_every_key_of_the_configuration_is_documented() -> None:
    text = (DOCS / "configuration.md").read_text()
    assert text == _reference.configuration(), (
        "run tools/docs (or python tools/_reference.py) and commit docs/configuration.md"
    )
    for where, section in _reference.sections():
        assert (section.__doc__ or "").strip(), where
        missing = [name for name, said in _reference._texts(section).items() if not said]
        nested = {
            f.name for f in _reference.msgspec.structs.fields(section) if _reference._section_of(f.type)
        }
        assert set(missing) <= nested, f"{where}: no words for {missing}"


def test_every_key_of_the_reference_cell_is_listed() -> None:
    text = (DOCS / "configuration.md").read_text()

    def leaves(data: Any) -> set[str]:
        if not isinstance(data, dict):
            return set()
        return {k for k, v in data.items() if not isinstance(v, dict)}.union(*map(leaves, data.values()))

    keys = leaves(yaml.safe_load((ROOT / "urdf" / "cell.yaml").read_text())) - {"belt", "person"}
    assert all(f"| `{key}` |" in text for key in keys)


def test_the_site_has_every_page() -> None:
    site = yaml.safe_load((ROOT / "mkdocs.yml").read_text())
    listed = {name for entry in site["nav"] for name in entry.values()}
    assert listed == {page.name for page in PAGES}, "nav in mkdocs.yml and docs/*.md differ"


@pytest.mark.parametrize("page", [*PAGES, ROOT / "README.md"], ids=lambda p: p.name)
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.S)
    for target in re.findall(r"\]\(([^)]+)\)", text):
        if "://" in target or target.startswith(("mailto:", "#")):
            continue
        file, _, anchor = target.partition("#")
        linked = (page.parent / file).resolve()
        assert linked.exists(), f"{page.name}: {target}"
        if anchor and linked.suffix == ".md":
            heads = re.findall(r"^#+ (.*)$", linked.read_text(), flags=re.M)
            slugs = {re.sub(r"[^\w\- ]", "", h.lower()).strip().replace(" ", "-") for h in heads}
            assert anchor in slugs, f"{page.name}: {target}"


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_pages_name_commands_that_exist(page: Path) -> None:
    verbs = {words[0] for words, _ in _reference.verbs()}
    for verb in re.findall(r"(?:^|`)cell ([a-z][a-z-]+)", page.read_text(), flags=re.M):
        assert verb in verbs, f"{page.name}: cell {verb}"
    for tool in re.findall(r"\btools/([a-z_]+)\b(?!\.)", page.read_text()):
        assert (ROOT / "tools" / tool).exists(), f"{page.name}: tools/{tool}"


def test_the_site_builds_without_a_dead_link(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", tmp_path / "site"],
        cwd=ROOT, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "site" / "configuration.html").is_file()
