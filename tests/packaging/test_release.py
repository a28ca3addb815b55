"""tools/release.py in a repository of its own, whose wheels are built in no time."""

from __future__ import annotations

import datetime
import hashlib
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CHANGES = "# Changelog\n\n## Unreleased\n\n### Added\n\n- A filter.\n\n## 0.1.0 (2020-01-01)\n\n- All of it.\n"
# Stands in for tools/build_wheels.py: packs the version that it finds and what it was asked for.
BUILD = """
import os, pathlib, sys
root, dist = pathlib.Path(__file__).parents[1], pathlib.Path(sys.argv[sys.argv.index("--dist") + 1])
if (root / "broken").exists():
    sys.exit("it does not compile")
version = (root / "python/kvision/_version.py").read_text().split('"')[1]
dist.mkdir(parents=True)
(dist / f"kvision-{version}.tar.gz").write_text("sources")
(dist / f"kvision-{version}-py3-none-any.whl").write_text("CUDA " + os.environ["KVISION_CUDA"])
"""


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    if shutil.which("git") is None:
        pytest.skip("there is no git")
    root = tmp_path / "repository"
    files = {
        "python/kvision/_version.py": '__version__ = "0.1.0"\n',
        "CHANGELOG.md": CHANGES,
        "tools/build_wheels.py": BUILD,
        "tools/release.py": (ROOT / "tools/release.py").read_text(),
        ".gitignore": "dist\n",
    }
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    git(root, "init", "--quiet", "--initial-branch=main")
    for key, value in (("name", "Test"), ("email", "test@example.org"), ("signingkey", "")):
        git(root, "config", f"user.{key}", value)
    commit(root, "First")
    return root


def git(root: Path, *words: str) -> str:
    return subprocess.run(["git", "-C", root, *words], check=True, capture_output=True, text=True).stdout.strip()


def commit(root: Path, message: str) -> None:
    git(root, "add", ".")
    git(root, "commit", "--quiet", "--message", message)


def release(root: Path, *words: str) -> tuple[int, str]:
    command = [sys.executable, "tools/release.py", *words]
    result = subprocess.run(command, cwd=root, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    return result.returncode, result.stdout


def test_a_dry_run_says_what_it_would_do(repository: Path) -> None:
    before = git(repository, "rev-parse", "HEAD")
    status, output = release(repository, "0.2.0", "--variants", "cpu")
    assert status == 0, output
    assert '+__version__ = "0.2.0"' in output and f"+## 0.2.0 ({datetime.date.today()})" in output
    assert "tag: v0.2.0" in output and "dry run" in output
    assert git(repository, "rev-parse", "HEAD") == before and not git(repository, "tag") + git(
        repository, "status", "--porcelain"
    )
    assert not (repository / "dist").exists()


def test_a_release(repository: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CUDACXX", sys.executable)  # any program: nothing is compiled
    (repository / "notes.txt").write_text("a file that git does not know")
    status, output = release(repository, "0.2.0", "--do")
    assert status == 0, output
    assert git(repository, "log", "-1", "--format=%s") == "Release 0.2.0"
    assert git(repository, "rev-parse", "v0.2.0^{commit}") == git(repository, "rev-parse", "HEAD")
    assert git(repository, "cat-file", "-t", "v0.2.0") == "tag"
    assert git(repository, "branch", "--show-current") == "main"
    assert len(git(repository, "worktree", "list").splitlines()) == 1
    assert (repository / "python/kvision/_version.py").read_text() == '__version__ = "0.2.0"\n'
    heading = f"## Unreleased\n\n## 0.2.0 ({datetime.date.today()})\n\n### Added\n\n- A filter.\n\n## 0.1.0"
    assert heading in (repository / "CHANGELOG.md").read_text()
    dist = repository / "dist/0.2.0"
    assert (dist / "cuda/kvision-0.2.0-py3-none-any.whl").read_text() == "CUDA ON"
    assert (dist / "cpu/kvision-0.2.0-py3-none-any.whl").read_text() == "CUDA OFF"
    sums = dict(line.split("  ")[::-1] for line in (dist / "SHA256SUMS").read_text().splitlines())
    assert len(sums) == 3
    for name, digest in sums.items():
        assert hashlib.sha256((dist / name).read_bytes()).hexdigest() == digest
    assert "git push origin HEAD v0.2.0" in output
    # A second release of the same version is refused, and so is one of nothing.
    status, output = release(repository, "0.2.0", "--variants", "cpu")
    assert status == 1 and "the tag v0.2.0 exists" in output
    status, output = release(repository, "0.3.0", "--variants", "cpu")
    assert status == 1 and "nothing under '## Unreleased'" in output


def test_the_first_release_keeps_the_version(repository: Path) -> None:
    status, output = release(repository, "0.1.0", "--variants", "cpu", "--do")
    assert status == 1 and "CHANGELOG.md has a heading 0.1.0 already" in output
    (repository / "CHANGELOG.md").write_text(CHANGES.partition("## 0.1.0")[0])
    commit(repository, "Describe the first release")
    status, output = release(repository, "0.1.0", "--variants", "cpu", "--do")
    assert status == 0, output
    assert git(repository, "tag") == "v0.1.0"
    assert [path.name for path in (repository / "dist/0.1.0/cpu").iterdir()] == ["kvision-0.1.0-py3-none-any.whl"]


def test_a_build_that_fails_leaves_no_trace(repository: Path) -> None:
    (repository / "broken").touch()
    commit(repository, "Break it")
    before = git(repository, "rev-parse", "HEAD")
    status, output = release(repository, "0.2.0", "--variants", "cpu", "--do")
    assert status == 1 and "it does not compile" in output and "nothing is tagged" in output
    assert git(repository, "rev-parse", "HEAD") == before and not git(repository, "tag")
    assert not git(repository, "status", "--porcelain") and not (repository / "dist").exists()
    assert len(git(repository, "worktree", "list").splitlines()) == 1


@pytest.mark.parametrize(
    "version, reason",
    [("0.0.9", "0.0.9 is older than 0.1.0"), ("2", "expected a version such as 0.2.0, got '2'")],
)
def test_wrong_versions_are_refused(repository: Path, version: str, reason: str) -> None:
    status, output = release(repository, version, "--variants", "cpu", "--do")
    assert status == 1 and reason in output


def test_uncommitted_changes_and_a_missing_compiler_are_refused(
    repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (repository / "CHANGELOG.md").write_text(CHANGES + "\n")
    monkeypatch.setenv("CUDACXX", "/nonexistent/nvcc")
    status, output = release(repository, "0.2.0", "--do")
    assert status == 1 and "not committed:\nM CHANGELOG.md" in output and "the CUDA wheel needs nvcc" in output
