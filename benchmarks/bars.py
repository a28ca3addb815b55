"""Checks of bars against measurements, and the peers that are faster than kvision."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from benchmarks.case import Case
from benchmarks.measure import BACKWARD, BOTH, FORWARD, KVISION, Row

HOST = 15e-6  # seconds of host time for one call on one image, GPU
TIE = 1.02  # a peer has to be faster by more than this to be reported
EXTRA = 0.05  # GPU memory of forward + backward beyond input, output and gradients, in units of input + output


@dataclass(frozen=True)
class CheckedBar:
    """One bar: the measurement, the limit, and whether the bar is met. `is_lower_limit` marks limits from below."""

    case: str
    size: str
    dtype: str
    what: str
    measured: float
    limit: float
    is_lower_limit: bool = False

    @property
    def met(self) -> bool:
        return self.measured >= self.limit if self.is_lower_limit else self.measured <= self.limit


@dataclass(frozen=True)
class Loss:
    """A peer that is `factor` times faster than kvision."""

    case: str
    size: str
    dtype: str
    stage: str
    peer: str
    factor: float
    agreement: str | None


def check(cases: Iterable[Case], rows: Sequence[Row], cuda: bool) -> list[CheckedBar]:
    """Compare the rows with the bars of their cases. Bars are for float32; `half` compares with float16."""
    bars_of = {case.name: case.bars for case in cases}
    checked = []
    for name, size in dict.fromkeys((row.case, row.size) for row in rows):
        row_of = {(r.library, r.stage, r.dtype): r for r in rows if (r.case, r.size) == (name, size) and not r.failure}
        row = row_of.get((KVISION, FORWARD, "float32"))
        if row is None:
            continue
        bars = bars_of[name]
        both, back = (row_of.get((KVISION, stage, "float32")) for stage in (BOTH, BACKWARD))
        half = row_of.get((KVISION, FORWARD, "float16"))
        if cuda:
            figures = [
                ("floor", row.value / row.floor, bars.floor),
                ("f+b floor", both and both.value / both.floor, bars.both),
                ("backward/forward", back and back.value / row.value, bars.backward),
                ("f+b extra memory", both and both.extra, EXTRA),
                ("launches", row.launches, bars.launches),
                ("host us", row.host and row.host * 1e6, HOST * 1e6),
                ("float16 speed-up", half and row.value / half.value, bars.half),
            ]
        else:
            limits = {"opencv": bars.opencv, "kornia": bars.kornia}
            peers = {name: row_of.get((name, FORWARD, "float32")) for name in limits}
            figures = [(f"of {p}'s time", peer and row.value / peer.value, limits[p]) for p, peer in peers.items()]
        checked += [
            CheckedBar(name, size, row.dtype, what, measured, limit, is_lower_limit=what == "float16 speed-up")
            for what, measured, limit in figures
            if measured is not None and limit is not None
        ]
    return checked


def losses(rows: Sequence[Row]) -> list[Loss]:
    """Every row where a peer is faster than kvision, the worst first."""
    signs: Mapping[tuple[str, ...], str | None] = {
        (r.case, r.size, r.dtype, r.library): r.agreement for r in rows if r.stage == FORWARD
    }
    times = {(r.case, r.size, r.dtype, r.stage, r.library): r.value for r in rows if r.failure is None}
    lost = []
    for (case, size, dtype, stage, peer), value in times.items():
        ours = times.get((case, size, dtype, stage, KVISION))
        if ours is not None and ours > TIE * value:
            lost.append(Loss(case, size, dtype, stage, peer, ours / value, signs.get((case, size, dtype, peer))))
    return sorted(lost, key=lambda loss: -loss.factor)
