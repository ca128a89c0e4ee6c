"""The tree is small: a training that reaches a GPU takes it along, and so does each clone. Files of
tests have names of their own.
"""

import shutil
import subprocess
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[2]
MOST_BYTES = 20_000_000
"""The shipped networks and their checkpoint take 10.5 MB.

Weights of ablations are made again by their command.
"""


def tracked() -> list[Path]:
    """The files of the tree; none where it is not one of git, as of an sdist."""
    git = shutil.which("git")
    if git is None:
        return []
    listed = subprocess.run(
        [git, "ls-files", "-z"], cwd=ROOT, capture_output=True, encoding="utf-8", check=False
    )
    return [ROOT / name for name in listed.stdout.split("\0") if name]


def test_the_tree_is_small() -> None:
    sizes = {path: path.lstat().st_size for path in tracked() if path.exists()}
    largest = sorted(sizes, key=lambda path: -sizes[path])[:5]
    assert sum(sizes.values()) < MOST_BYTES, [
        f"{path.relative_to(ROOT)}: {sizes[path]}" for path in largest
    ]


def test_no_two_files_of_tests_have_one_name() -> None:
    """By it pytest imports them: a second one ends the collection of all."""
    names = Counter(path.name for path in (ROOT / "tests").rglob("test_*.py"))
    assert [name for name, count in names.items() if count > 1] == []
