"""Links between documents lead somewhere, every document has a place on the site, and the site builds."""

from __future__ import annotations

import html
import re
import subprocess
import sys
import unicodedata
from pathlib import Path

import pytest
import yaml

import ear_jax

ROOT = Path(__file__).parents[2]
DOCUMENTS = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
LINK = re.compile(r"\]\(([^)\s]+)\)|<(?:img|a)[^>]+(?:src|href)=\"([^\"]+)\"")


def prose(path: Path) -> str:
    """Returns a document without its code."""
    return re.sub(r"^```.*?^```|`[^`\n]*`", "", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)


def anchors(path: Path) -> set[str]:
    """Returns the anchors of a document's headings, as GitHub and Python-Markdown make them."""
    titles = re.findall(
        r"^#+ (.+)$", re.sub(r"^```.*?^```", "", path.read_text(), flags=re.DOTALL | re.MULTILINE), re.M
    )
    plain = (unicodedata.normalize("NFKD", title.replace("`", "")).lower() for title in titles)
    return {re.sub(r"[\s]+", "-", re.sub(r"[^\w\s-]", "", title).strip()) for title in plain}


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_no_link_is_dead(path):
    for groups in LINK.findall(prose(path)):
        target, _, anchor = "".join(groups).partition("#")
        if re.match(r"[a-z]+:", target):
            continue
        file = (path.parent / target).resolve() if target else path
        made = {"cli.md": path} if path.parent.name == "reference" else {}  # written when the site is built
        assert file.exists() or file.name in made, f"{path.name} links to {target}"
        assert not anchor or anchor in anchors(file), f"{path.name} links to {target}#{anchor}"


def test_every_document_is_on_the_site():
    def pages(entry) -> list[str]:
        if isinstance(entry, str):
            return [entry]
        return [page for part in (entry.values() if isinstance(entry, dict) else entry) for page in pages(part)]

    listed = set(pages(yaml.safe_load((ROOT / "mkdocs.yml").read_text())["nav"]))
    written = {str(path.relative_to(ROOT / "docs")) for path in (ROOT / "docs").rglob("*.md")}
    made = {"index.md", "contributing.md", "changelog.md", "reference/cli.md"}  # by docs/site/hooks.py
    assert written | made == listed, "give a new document its line in mkdocs.yml"


def test_versions_agree():
    assert f"\nversion: {ear_jax.__version__}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"\n## {ear_jax.__version__}\n" in (ROOT / "CHANGELOG.md").read_text()


def test_the_command_line_is_told_whole(monkeypatch):
    """Every flag of every command, from the parser itself."""
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "site"))
    import cli_reference

    from ear_jax.cli.completion import commands
    from ear_jax.cli.flags import flags_of

    page = cli_reference.page()
    for name, kind in commands().items():
        (section,) = re.findall(rf"^## ear {name}\n(.*?)(?=^## |\Z)", page, re.DOTALL | re.MULTILINE)
        for flag in flags_of(kind):
            assert flag.replace("--no-", "--") in section, f"ear {name} {flag}"
        assert "**  \n\n" not in section, f"an option of ear {name} is not described"


def test_what_the_table_of_peers_says_of_us_are_commands_that_there_are():
    """Every command, flag, target and file in our column."""
    from ear_jax.cli.completion import commands
    from ear_jax.cli.flags import flags_of

    table = (ROOT / "docs" / "peers.md").read_text()
    ours = [line.split("|")[2] for line in table.splitlines() if line.startswith("| ") and " ear_jax |" not in line]
    said = [words for cell in ours for words in re.findall(r"`([^`]+)`", cell)]
    kinds, found = commands(), 0
    for words in said:
        if words.startswith("ear "):
            name, *rest = words.split()[1:]
            flags = flags_of(kinds[name])
            assert all(word in flags for word in rest if word.startswith("--")), words
            found += 1
        elif words.startswith("--"):
            assert words.split()[0] in flags_of(kinds["train"]), words
        elif words.startswith("make "):
            assert f"\n{words.split()[1]}:" in (ROOT / "Makefile").read_text()
        elif ("/" in words and "(" not in words) or words.endswith(".cff"):
            assert (ROOT / words).is_file(), words
    assert found > 8


@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path):
    """Without a network, and with every link inside of it alive."""
    pytest.importorskip("mkdocstrings", reason="needs the group docs")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path)]
    environment = {"PATH": "", "HOME": str(tmp_path), "NO_MKDOCS_2_WARNING": "1", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=600)
    assert (done.returncode, done.stdout + done.stderr) == (0, "")
    for page in tmp_path.rglob("*.html"):
        text = page.read_text()
        assert not re.findall(r"(?:src|href)=\"(?:https?:)?//[^\"]+\.(?:js|css|woff2?)", text), page
        for link in re.findall(r"(?:src|href)=\"([^\"]+)\"", text):
            target, _, anchor = html.unescape(link).partition("#")
            if re.match(r"[a-z]+:", target) or page.name == "404.html":
                continue
            file = (page.parent / target) if target else page
            assert file.exists(), f"{page.name}: {link}"
            if anchor and file.suffix == ".html":
                assert f'id="{anchor}"' in file.read_text(), f"{page.name}: {link}"
