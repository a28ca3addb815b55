"""A release in one command: version, changelog, wheels, checksums, tag.

    python tools/release.py 0.2.0                   says what it would do; changes nothing
    python tools/release.py 0.2.0 --do              does it, here
    python tools/release.py 0.2.0 --do --variants cpu    without the CUDA wheel, which needs nvcc

The version goes into python/kvision/_version.py, where pip and CMake read it. What is under "Unreleased" in CHANGELOG.md gets
the version as its heading. Both are committed in a work tree of their own. The sdist and the wheels are built there, so that they
hold what is committed and nothing else. Only when all of it is built does the branch move to that commit, which gets the tag. A
failure leaves branch and tags as they were. Results are in dist/VERSION: cpu/ and cuda/ with a wheel each, the sdist, SHA256SUMS.
Nothing leaves this machine; the last lines say which commands publish it.
"""

from __future__ import annotations

import argparse
import datetime
import difflib
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
VERSION = Path("python/kvision/_version.py")
CHANGELOG = Path("CHANGELOG.md")
UNRELEASED = "## Unreleased\n"
VARIANTS = {"cpu": "OFF", "cuda": "ON"}  # the folder of a wheel, and KVISION_CUDA


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("version", help="such as 0.2.0")
    parser.add_argument("--do", action="store_true", help="do it; without, it is only said")
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS), help="default: both wheels")
    options = parser.parse_args(arguments)
    version, dist = options.version, ROOT / "dist" / options.version
    if problems := refusals(version, options.variants):
        sys.exit("\n".join(f"release: {problem}" for problem in problems))
    edits = {VERSION: with_version(version), CHANGELOG: with_heading(version, datetime.date.today())}
    for path, text in edits.items():
        before = (ROOT / path).read_text().splitlines()
        print("\n".join(difflib.unified_diff(before, text.splitlines(), str(path), str(path), n=1, lineterm="")))
    print(f"commit: Release {version}; tag: v{version}; sdist and wheels ({', '.join(options.variants)}): {dist}")
    if not options.do:
        print("This was a dry run: --do does it.")
        return
    release(version, edits, options.variants, dist)
    print(f"{dist}:\n{(dist / 'SHA256SUMS').read_text()}To publish it:")
    print(f"  git push origin HEAD v{version}")
    print(f"  python -m twine upload {dist}/*.tar.gz {dist}/{options.variants[-1]}/*.whl")


def git(*words: object, root: Path = ROOT) -> str:
    command = ["git", "-C", str(root), *map(str, words)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def numbers(version: str) -> tuple[int, ...]:
    return tuple(map(int, version.split(".")))


def refusals(version: str, variants: list[str]) -> list[str]:
    """Why this cannot be released now."""
    if not re.fullmatch(r"\d+\.\d+\.\d+", version):
        return [f"expected a version such as 0.2.0, got {version!r}"]
    problems = []
    match = re.search(r'__version__ = "(\d+\.\d+\.\d+)"', (ROOT / VERSION).read_text())
    if match is None:
        problems.append(f'{VERSION} has no line __version__ = "1.2.3"')
    elif numbers(version) < numbers(match[1]):
        problems.append(f"{version} is older than {match[1]}, the version in {VERSION}")
    if git("tag", "--list", f"v{version}"):
        problems.append(f"the tag v{version} exists")
    if changed := git("status", "--porcelain", "--untracked-files=no"):
        problems.append(f"there are changes that are not committed:\n{changed}")
    if re.search(rf"^## {re.escape(version)}\b", (ROOT / CHANGELOG).read_text(), re.MULTILINE):
        problems.append(f"{CHANGELOG} has a heading {version} already")
    if not unreleased():
        problems.append(f"{CHANGELOG} has nothing under {UNRELEASED.strip()!r}")
    if "cuda" in variants and shutil.which(os.environ.get("CUDACXX", "nvcc")) is None:
        problems.append("the CUDA wheel needs nvcc on the PATH or CUDACXX; --variants cpu leaves it out")
    return problems


def unreleased() -> str:
    """What changed since the last release."""
    _, _, rest = (ROOT / CHANGELOG).read_text().partition(UNRELEASED)
    return re.split(r"^## ", rest, maxsplit=1, flags=re.MULTILINE)[0].strip()


def with_version(version: str) -> str:
    return re.sub(r'__version__ = "[^"]*"', f'__version__ = "{version}"', (ROOT / VERSION).read_text())


def with_heading(version: str, day: datetime.date) -> str:
    text = (ROOT / CHANGELOG).read_text()
    return text.replace(UNRELEASED, f"{UNRELEASED}\n## {version} ({day.isoformat()})\n", 1)


def release(version: str, edits: dict[Path, str], variants: list[str], dist: Path) -> None:
    with tempfile.TemporaryDirectory() as folder:
        source, built = Path(folder, "kvision"), Path(folder, "dist")
        git("worktree", "add", "--quiet", "--detach", source)
        try:
            for path, text in edits.items():
                (source / path).write_text(text)
            git("add", *edits, root=source)
            git("commit", "--quiet", "--allow-empty", "--message", f"Release {version}", root=source)
            commit = git("rev-parse", "HEAD", root=source)
            for variant in variants:
                command = [sys.executable, str(source / "tools/build_wheels.py"), "--dist", str(built / variant)]
                environment = {**os.environ, "KVISION_CUDA": VARIANTS[variant]}
                subprocess.run(command, cwd=source, env=environment, check=True)
        except subprocess.CalledProcessError as error:
            said = error.stderr or ""
            sys.exit(
                f"{said}release: {' '.join(map(str, error.cmd))} failed; nothing is tagged, the branch is as it was"
            )
        finally:
            git("worktree", "remove", "--force", source)
        gather(built, dist)
    git("merge", "--quiet", "--ff-only", commit)
    git("tag", "--annotate", f"v{version}", "--message", f"kvision {version}", commit)


def gather(built: Path, dist: Path) -> None:
    """The wheels in a folder for each variant, one sdist for all of them, and the checksums."""
    shutil.rmtree(dist, ignore_errors=True)
    dist.mkdir(parents=True)
    for wheel in sorted(built.glob("*/*.whl")):
        (dist / wheel.parent.name).mkdir()
        shutil.copy(wheel, dist / wheel.parent.name)
    shutil.copy(next(built.glob("*/*.tar.gz")), dist)
    files = sorted([*dist.glob("*.tar.gz"), *dist.glob("*/*.whl")])
    lines = [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.relative_to(dist)}\n" for path in files]
    (dist / "SHA256SUMS").write_text("".join(lines))


if __name__ == "__main__":
    main()
