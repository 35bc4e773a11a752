"""Lines of code by room. Exit status 1 if there are more than ``[tool.aero-bayes]`` in pyproject.toml allows."""

import sys
import tomllib
from collections import Counter
from pathlib import Path

KINDS = {".py", ".c", ".h", ".inc", ".jinja", ".css", ".js"}
#: Of what is not code: models and tables, counted so that lines do not move there from code.
TABLES = {".mo", ".toml", ".json", ".csv"}
root = Path(__file__).resolve().parents[1]


def lines(folder: str, kinds: set[str] = KINDS) -> dict[Path, int]:
    """Lines of each file of these kinds below a folder."""
    return {
        path.relative_to(root): len(path.read_bytes().splitlines())
        for path in sorted((root / folder).rglob("*"))
        if path.suffix in kinds
    }


limits = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["aero-bayes"]
ours = lines("src") | lines("studies") | lines("benchmarks")
rooms: Counter[str] = Counter()
files: Counter[str] = Counter()
for path, count in ours.items():
    inner = path.parts[2:] if path.parts[0] == "src" else path.parts
    room = inner[0] if len(inner) > 1 else "(root)"
    rooms[room] += count
    files[room] += 1
for room, count in rooms.most_common():
    print(f"{count:7,} lines {files[room]:4} files  {room}")
tables = lines("docs", {".py"})
for folder in ("modelica", "studies", "tests"):
    tables |= lines(folder, TABLES)
total, tests, other = (sum(of.values()) for of in (ours, lines("tests"), tables))
print(f"{total:7,} lines {len(ours):4} files  src, studies and benchmarks (at most {limits['max_lines']:,})")
print(f"{tests:7,} lines            tests (at most {limits['max_test_lines']:,})")
print(f"{other:7,} lines            models and tables, docs/*.py (at most {limits['max_table_lines']:,})")
if total > limits["max_lines"] or tests > limits["max_test_lines"] or other > limits["max_table_lines"]:
    sys.exit("Remove what the change replaces; or raise the limit in pyproject.toml and say in the message what for.")
