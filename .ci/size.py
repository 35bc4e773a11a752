"""Lines of code by room. Exit status 1 if there are more than ``[tool.aero-bayes] max_lines`` in
pyproject.toml allows."""

import sys
import tomllib
from collections import Counter
from pathlib import Path

KINDS = {".py", ".c", ".h", ".inc", ".jinja", ".css", ".js"}
root = Path(__file__).resolve().parents[1]


def lines(folder: str) -> dict[Path, int]:
    """Lines of each file of code below a folder."""
    return {
        path.relative_to(root): len(path.read_bytes().splitlines())
        for path in sorted((root / folder).rglob("*"))
        if path.suffix in KINDS
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
total, tests = sum(ours.values()), sum(lines("tests").values())
print(f"{total:7,} lines {len(ours):4} files  src, studies and benchmarks (at most {limits['max_lines']:,})")
print(f"{tests:7,} lines            tests (at most {limits['max_test_lines']:,})")
if total > limits["max_lines"] or tests > limits["max_test_lines"]:
    sys.exit("Remove what the change replaces; or raise the limit in pyproject.toml and say in the message what for.")
