"""Programs in fresh processes: forks of one that has imported torch alone, which takes longer than most of them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

SERVER = """
import json, os, sys, torch
for request in sys.stdin:
    program, arguments, environment, folder, output = json.loads(request)
    child = os.fork()
    if not child:
        break
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
else:
    sys.exit()
os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
for number, name in ((1, "stdout"), (2, "stderr")):
    os.dup2(os.open(os.path.join(output, name), os.O_WRONLY | os.O_CREAT), number)
os.chdir(folder)
os.environ.clear()
os.environ.update(environment)
sys.argv[1:] = arguments
exec(compile(program, "<string>", "exec"), {"__name__": "__main__"})
"""


@cache
def _server() -> subprocess.Popen[str]:
    """Ends with this process, which closes its input."""
    command, pipe = [sys.executable, "-c", SERVER], subprocess.PIPE
    return subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True)


def run(program: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Like `python -c program arguments`, after `import torch`."""
    server = _server()
    with tempfile.TemporaryDirectory() as output:
        request = program, arguments, {**os.environ, **environment}, os.getcwd(), output
        print(json.dumps(request), file=server.stdin, flush=True)
        code = int(server.stdout.readline())
        texts = [(Path(output) / name).read_text() for name in ("stdout", "stderr")]
    return subprocess.CompletedProcess(program, code, *texts)
