"""Looks for loops that ptxas breaks: python tools/check_machine_code.py FILE...

Files are objects, libraries or cubins with machine code of CUDA; cuobjdump of its toolkit reads them. Fails if it finds a loop.

Where each turn of a loop computes `-bound` to compare with it, ptxas from 12.1 on may negate a register at the turn's begin
and find the bound there at its end, for the next turn; the one of the first turn it forgets
(findings/ptxas_negates_before_the_bound.sh). nvcc writes such loops by itself, of bounds that it would otherwise keep in
registers. To mend one, find the bound where the compiler cannot move it into the loop: in one thread of the block, say, which
leaves it in shared memory.

Reported are negations in loops of what all turns compute alike behind them, while the first turn has what another kind of
instruction has computed, or nothing.
"""

import concurrent.futures
import functools
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator

INSTRUCTION = re.compile(r"/\*[0-9a-f]{4,}\*/ +(?:@(!?U?P\w+) +)?([A-Z][\w.]*) *(.*?) ;")
REGISTER = re.compile(r"\bR(\d+)")
NEGATION = re.compile(r"IMAD\.MOV R\d+, RZ, RZ, -R(\d+)|IADD3? R\d+, (?:PT, PT, )?-R(\d+), RZ(?:, RZ)?")
COPY = re.compile(r"(?:IMAD\.)?MOV")
# Their first register is no result.
READERS = re.compile(r"[A-Z0-9]*SETP|FCHK|ST|RED\b|R2P|BRA|BRX|CALL|RET|BAR|WARPSYNC|CCTL|ATOMS?\.POPC")
CHANGING = re.compile(r"LD(?!C)|ATOM|SHFL|S2R|CS2R|VOTE|MATCH|CALL")
ANYTHING = frozenset(range(255))
BEGIN = -1  # of the kernel, where registers have no value


class Instruction:
    def __init__(self, predicate: str, name: str, operands: str):
        self.predicate, self.name, self.operands = predicate, name, operands
        parts = [part for part in operands.replace(".reuse", "").split(", ") if not re.fullmatch(r"!?U?P[T\d]", part)]
        result = re.fullmatch(r"R(\d+)", parts[0]) if parts else None
        wide = bool(re.match(r"D[A-Z]|CS2R$", name)) or bool(re.search(r"\.64|\.WIDE|F64", name))
        self.written: frozenset[int] = frozenset()
        if result and not READERS.match(name):
            narrow = re.match(r"F2I(?!.*64\.F)|F2F\.F32|MUFU", name)
            count = 4 if ".128" in name or re.match(r"[IDBH]G?MMA", name) else 2 if wide and not narrow else 1
            self.written = frozenset(range(int(result[1]), int(result[1]) + count))
            parts = parts[1:]
        numbers = {int(number) for part in parts for number in REGISTER.findall(part)}
        self.read = numbers | {number + 1 for number in numbers if wide}

    def __str__(self) -> str:
        return f"{self.name} {self.operands}"


class Kernel:
    """The instructions of a kernel, and what leads where."""

    def __init__(self, code: list[Instruction]):
        self.code = code
        self.before: list[list[int]] = [[] for _ in code]
        for i, one in enumerate(code):
            follows = i + 1 < len(code) and (bool(one.predicate) or not re.match(r"EXIT|RET|BRX|BRA", one.name))
            if self.is_branch(i):
                self.before[self.target(i)].append(i)
                follows = bool(one.predicate) or bool(re.match(r"!?U?P\d", one.operands)) or one.name != "BRA"
            if follows and i + 1 < len(code):
                self.before[i + 1].append(i)

    def is_branch(self, i: int) -> bool:
        return self.code[i].name.startswith("BRA")

    def target(self, i: int) -> int:
        return min(int(re.findall(r"0x([0-9a-f]+)", self.code[i].operands)[-1], 16) // 16, len(self.code) - 1)

    @functools.cache  # noqa: B019
    def written_by(self, i: int) -> frozenset[int]:
        if not self.code[i].name.startswith("CALL"):
            return self.code[i].written
        if not re.search(r"0x[0-9a-f]+", self.code[i].operands):
            return ANYTHING
        # Functions lie behind the kernel, each up to its return.
        written: set[int] = set()
        for one in self.code[self.target(i) :]:
            written |= one.written
            if one.name.startswith("RET"):
                break
        return frozenset(written)

    def sources(self, i: int, register: int) -> set[int]:
        """The instructions whose result instruction i may read there."""
        seen, found, work = set(), set(), [i]
        while work:
            at = work.pop()
            if at == 0:
                found.add(BEGIN)
            for one in self.before[at]:
                if one in seen:
                    continue
                seen.add(one)
                if register in self.written_by(one):
                    found.add(one)
                else:
                    work.append(one)
        return found

    @functools.cached_property
    def loops(self) -> list[set[int]]:
        """What lies between the head of each loop and its branches back, the shortest loop first."""
        bodies: dict[int, set[int]] = {}
        for end in range(len(self.code)):
            if self.is_branch(end) and self.target(end) <= end:
                head = self.target(end)
                body, work = {head, end}, [end] if end != head else []
                while work:
                    for one in self.before[work.pop()]:
                        if one not in body:
                            body.add(one)
                            work.append(one)
                if 0 not in body or head == 0:  # otherwise it is entered elsewhere: a detour behind the kernel
                    bodies.setdefault(head, set()).update(body)
        return sorted(bodies.values(), key=len)

    def changes(self, i: int, loop: set[int], visited: dict[int, bool]) -> bool:
        """Whether the result of an instruction of a loop may differ from turn to turn."""
        if i not in loop:
            return False
        if i not in visited:
            visited[i] = True  # if it is met again, it depends on itself
            visited[i] = bool(CHANGING.match(self.code[i].name)) or any(
                self.changes(source, loop, visited)
                for register in self.code[i].read
                for source in self.sources(i, register)
            )
        return visited[i]

    def findings(self) -> Iterator[str]:
        for i, one in enumerate(self.code):
            negated = NEGATION.fullmatch(str(one).replace(".reuse", ""))
            if not negated:
                continue
            register = int(negated[1] or negated[2])
            sources = self.sources(i, register)
            if len(sources) == 1:
                continue
            for loop in self.loops:
                later = sources & loop
                before = sources - loop
                if i in loop and later and before:
                    kinds = set().union(*map(self.kinds, later))
                    if not any(self.changes(one, loop, {}) for one in later) and any(
                        not self.kinds(s) & kinds for s in before
                    ):
                        first = ", ".join("nothing" if s == BEGIN else str(self.code[s]) for s in sorted(before))
                        behind = ", ".join(f"{16 * s:#x} {self.code[s]}" for s in sorted(later))
                        yield f"{16 * i:#x} {one}; then {behind}; at first: {first}"
                    break

    def kinds(self, source: int, depth: int = 4) -> frozenset[str]:
        """The names of the instructions that computed a result, behind copies."""
        if source == BEGIN:
            return frozenset()
        one = self.code[source]
        if depth and COPY.match(one.name) and len(one.read) == 1:
            origins = self.sources(source, next(iter(one.read)))
            return frozenset().union(*(self.kinds(origin, depth - 1) for origin in origins))
        return frozenset({one.name.split(".")[0]})


def read(text: str) -> list[Instruction]:
    return [Instruction(*groups) for groups in INSTRUCTION.findall(text)]


def check(path: str) -> tuple[list[str], int]:
    tool = shutil.which("cuobjdump") or "/usr/local/cuda/bin/cuobjdump"
    text = subprocess.run([tool, "-sass", path], capture_output=True, text=True, check=True).stdout
    kernels = text.split("Function : ")[1:]
    found = []
    for part in kernels:
        found += [f"{path}: {part.split(maxsplit=1)[0]}:\n  {finding}" for finding in Kernel(read(part)).findings()]
    return found, len(kernels)


def main() -> int:
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    with concurrent.futures.ProcessPoolExecutor() as pool:
        results = list(pool.map(check, sys.argv[1:]))
    findings = [finding for found, _ in results for finding in found]
    print(*findings, f"{sum(count for _, count in results)} kernels, {len(findings)} broken loops", sep="\n")
    return bool(findings)


if __name__ == "__main__":
    sys.exit(main())
