"""What the documentation says to type is typed here, as it stands there."""

from __future__ import annotations

import ast
import importlib
import json
import os
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def cart(tmp_path: Path) -> Path:
    """A copy of the example's folder, without what a run left there."""
    left = shutil.ignore_patterns("out*", "my.toml", "other.toml", "fmu.toml", "*.fmu")
    return Path(shutil.copytree(ROOT / "examples" / "cart", tmp_path / "cart", ignore=left))


def blocks(page: str, language: str) -> list[str]:
    """Fenced blocks of a page, dedented."""
    text = (ROOT / page).read_text(encoding="utf-8")
    found = re.findall(rf"^( *)```{language}\n(.*?)^ *```$", text, flags=re.M | re.S)
    return [re.sub(rf"^{indent}", "", body, flags=re.M) for indent, body in found]


def typed(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return subprocess.run(
        ["bash", "-e", "-c", command], cwd=folder, env={**os.environ, "PATH": path}, capture_output=True, text=True
    )


def shape(text: str) -> str:
    """Without digits, the last of which depend on the processor, as the order of terms that do equally well."""
    return re.sub(r" +", " ", re.sub(r"\d[\d.,]*", "#", re.sub(r"\(\w+@[^)]* more\)", "(terms)", text.strip())))


@pytest.mark.long
def test_the_tutorials_commands_find_the_friction(cart: Path):
    """Every command of the tutorial runs, also where it was walked before, and prints every line that it promises.

    After it, the commands of the page on results, which begins with the tutorial's loop.
    """
    for left in ("my.toml", "other.toml"):
        (cart / left).write_text("# of the first walk", encoding="utf-8")
    printed = ""
    for command in blocks("docs/tutorial.md", "bash"):
        done = typed(command, cart)
        assert done.returncode == 0, f"{command}\n{done.stderr}"
        printed += done.stdout
    promised = blocks("docs/tutorial.md", "text")
    assert len(promised) >= 4
    for line in "".join(promised).splitlines():
        assert shape(line) in shape(printed), line
    loop, *others = blocks("docs/howto/use_the_result.md", "bash")
    first, shown = loop.splitlines()
    assert first in "".join(blocks("docs/tutorial.md", "bash")).splitlines()
    assert others
    if find_spec("ziglang") is None:  # the compiler for other machines
        others = [command for command in others if "--platforms" not in command]
    for command in (shown, *others):
        done = typed(command, cart)
        assert done.returncode == 0, f"{command}\n{done.stderr}"


@pytest.mark.long
@pytest.mark.parametrize(
    "page",
    ["docs/howto/model.md", "docs/howto/data.md", "docs/howto/fmu.md", "docs/howto/recordings.md"],
)
def test_commands_of_the_how_to_pages_run(page: str, cart: Path):
    commands = blocks(page, "bash")
    assert commands
    for command in commands:
        done = typed(command, cart)
        assert done.returncode == 0, f"{command}\n{done.stderr}"


def test_the_laws_of_the_how_to_page_are_read(cart: Path):
    """The file of a law as it stands on the page."""
    from aero_bayes.laws.law import read_laws

    (cart / "MyLaws.mo").write_text(blocks("docs/howto/law.md", 'modelica title="MyLaws.mo"')[0], encoding="utf-8")
    assert [law.id for law in read_laws([cart / "MyLaws.mo"])] == ["wind_drag"]


@pytest.mark.parametrize("page", ["model", "data", "priors", "loop", "law", "process_noise", "bad_fit"])
def test_tables_of_the_how_to_pages_are_valid(page: str, tmp_path: Path):
    """Each TOML block is one that the program reads."""
    from aero_bayes.config import load_config

    tables = blocks(f"docs/howto/{page}.md", "toml")
    assert tables
    for number, table in enumerate(tables):
        file = tmp_path / f"{number}.toml"
        file.write_text(table, encoding="utf-8")
        load_config(file)


def test_the_readmes_example_prints_what_it_says(cart: Path):
    (script,), (said,) = blocks("README.md", "python"), blocks("README.md", "text")
    done = subprocess.run([sys.executable, "-c", script], cwd=cart, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert shape(done.stdout) == shape(said)


@pytest.mark.long
def test_the_library_page_runs(cart: Path):
    script = "".join(blocks("docs/howto/python.md", "python"))
    done = subprocess.run([sys.executable, "-c", script], cwd=cart, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (cart / "loop.svg").is_file()


def test_what_the_pages_import_can_be_imported():
    """Every name that a block of Python imports or takes from the package, and every class that the text calls."""
    import aero_bayes

    pages = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    scripts = {page: "\n".join(blocks(str(page.relative_to(ROOT)), "python")) for page in pages}
    for notebook in sorted((ROOT / "examples").rglob("*.ipynb")):
        cells = json.loads(notebook.read_text("utf-8"))["cells"]
        code = "\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "code")
        scripts[notebook] = re.sub(r"^[!%].*$", "", code, flags=re.M)  # commands of the shell and of the notebook
    asked = 0
    for page, script in scripts.items():
        for node in ast.walk(ast.parse(script)):
            if isinstance(node, ast.ImportFrom) and str(node.module).partition(".")[0] == "aero_bayes":
                for one in node.names:
                    asked += 1
                    assert hasattr(importlib.import_module(str(node.module)), one.name), (page, one.name)
            own = isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
            if own and node.value.id == "aero_bayes":
                asked += 1
                assert hasattr(aero_bayes, node.attr), (page, node.attr)
        if page.suffix == ".md":
            for name in re.findall(r"(?<![\w.])([A-Z]\w*(?:Settings|Map|Spec))\(", page.read_text("utf-8")):
                asked += 1
                assert name in aero_bayes.__all__, (page, name)
    assert asked > 40


def test_public_names_are_what_they_say_after_their_rooms_are_imported():
    import aero_bayes

    for name in aero_bayes.__all__:
        assert callable(getattr(aero_bayes, name)), name
    assert not set(aero_bayes.__all__) & {room.name for room in Path(aero_bayes.__file__).parent.iterdir()}


def test_the_help_gives_whole_sentences():
    from click.testing import CliRunner

    from aero_bayes.cli import main

    said = " ".join(CliRunner().invoke(main, ["--help"], terminal_width=80).output.split())
    assert "..." not in said.partition("Commands:")[2]
    for command in main.commands.values():
        assert " ".join(str(command.help).split()) in said


def test_every_table_of_the_reference_is_written_from_the_code(monkeypatch, caplog):
    """Every mark in a page has its table, and every key of the configuration and public name is explained."""
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    reference = importlib.import_module("reference")
    marks = {m for page in (ROOT / "docs").rglob("*.md") for m in reference.MARK.findall(page.read_text("utf-8"))}
    assert marks == set(reference.GENERATORS)
    for mark in marks:
        assert "| --- |" in reference.GENERATORS[mark]() or mark in ("command_line", "library")
    assert not caplog.records
