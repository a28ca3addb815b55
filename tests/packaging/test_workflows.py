"""The workflows of GitHub: their schema, what their expressions name, and that the commands they run are here."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

yaml = pytest.importorskip("yaml", reason="reads the workflows")

ROOT = Path(__file__).parents[2]
WORKFLOWS = sorted(ROOT.glob(".github/workflows/*.yml"))
NAMES = [path.name for path in WORKFLOWS]
# What a runner has besides the shell's own: pip's programs are installed by a step.
PROGRAMS = {"make", "python", "dnf", "echo", "sudo"}

pytestmark = pytest.mark.skipif(not WORKFLOWS, reason="the workflows are not here, this is an installed package")


def read(path: Path) -> dict[str, Any]:
    workflow = yaml.safe_load(path.read_text())
    workflow["on"] = workflow.pop(True)  # what YAML 1.1 makes of the word on
    return workflow


def program(name: str) -> str:
    """The path of a program of this environment or of the system; without it the test is skipped."""
    path = shutil.which(name, path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
    return path or pytest.skip(f"there is no {name}")


def scripts(workflow: dict[str, Any]) -> list[str]:
    return [step["run"] for job in workflow["jobs"].values() for step in job["steps"] if "run" in step]


@pytest.mark.parametrize("path", WORKFLOWS, ids=NAMES)
def test_schema(path: Path) -> None:
    command = (program("check-jsonschema"), "--builtin-schema", "github-workflows", path)
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout + result.stderr


@pytest.mark.parametrize("path", WORKFLOWS, ids=NAMES)
def test_expressions_name_existing_keys(path: Path) -> None:
    workflow = read(path)
    for name, job in workflow["jobs"].items():
        assert set([job["needs"]] if isinstance(job.get("needs"), str) else job.get("needs", ())) <= set(
            workflow["jobs"]
        )
        matrix = job.get("strategy", {}).get("matrix", {})
        axes = {*matrix, *(key for entry in matrix.get("include", ()) for key in entry)} - {"include", "exclude"}
        inputs = (workflow["on"].get("workflow_dispatch") or {}).get("inputs", {})
        steps = {step["id"] for step in job["steps"] if "id" in step}
        known = {"matrix": axes, "inputs": set(inputs), "steps": steps}
        for context, key in re.findall(r"\b(matrix|inputs|steps)\.([\w-]+)", str(job)):
            assert key in known[context], f"{name}: {context}.{key}"
        assert all(("uses" in step) != ("run" in step) for step in job["steps"])
        assert all(re.fullmatch(r"[\w-]+/[\w.-]+@v\d+", step["uses"]) for step in job["steps"] if "uses" in step)


@pytest.mark.parametrize("path", WORKFLOWS, ids=NAMES)
def test_commands_are_here(path: Path) -> None:
    """Targets of make, programs of tools with their options, and tests that are named."""
    targets = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for script in scripts(read(path)):
        subprocess.run(["bash", "-n"], input=re.sub(r"\$\{\{.*?\}\}", "x", script), check=True, text=True)
        for line in script.splitlines():
            words = re.sub(r"\$\{\{(.*?)\}\}", r"\1", line).split()
            assert words[0] in PROGRAMS, line
            if words[0] == "make":
                assert words[1] in targets, line
                for files in re.findall(r"TESTS=(\S+)", line):
                    assert (ROOT / files).exists(), line
            if words[:2] == ["python", "-m"]:
                tests = [word for word in words if word.startswith("tests/")]
                assert all((ROOT / test).exists() for test in tests), line
            elif words[0] == "python":
                command = (sys.executable, ROOT / words[1], "--help")
                text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
                assert set(re.findall(r"(--\w+)", line)) <= set(re.findall(r"(--\w+)", text)), line


@pytest.mark.parametrize("path", WORKFLOWS, ids=NAMES)
def test_shellcheck(path: Path) -> None:
    shellcheck = program("shellcheck")
    for script in scripts(read(path)):
        text = "#!/bin/bash\n" + re.sub(r"\$\{\{.*?\}\}", "x", script)
        result = subprocess.run([shellcheck, "-"], input=text, capture_output=True, text=True)
        assert result.returncode == 0, result.stdout


@pytest.mark.parametrize("path", WORKFLOWS, ids=NAMES)
def test_actionlint(path: Path) -> None:
    result = subprocess.run([program("actionlint"), "-no-color", path], capture_output=True, text=True)
    assert result.returncode == 0, result.stdout


def test_zizmor() -> None:
    """Credentials stay out of the working tree, and actions of others are pinned."""
    command = (program("zizmor"), "--offline", "--config", ROOT / ".github/zizmor.yml", *WORKFLOWS)
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout
