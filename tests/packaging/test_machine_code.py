"""tools/check_machine_code.py, on the machine code of a loop as ptxas 13.5 writes it for 9.0."""

from __future__ import annotations

import importlib.util
from pathlib import Path

spec = importlib.util.spec_from_file_location(
    "check_machine_code", Path(__file__).parents[2] / "tools/check_machine_code.py"
)
check_machine_code = importlib.util.module_from_spec(spec)
spec.loader.exec_module(check_machine_code)

# The loop compares with -R2, and its end copies the product in R5 to R2. R2 has half of an address at first.
LOOP = """
LDC.64 R2, c[0x0][0x210]
LDG.E R0, desc[UR4][R2.64]
LDG.E R5, desc[UR4][R2.64+0x4]
IMAD R5, R0, R5, RZ
{before}
ISETP.GE.AND P1, PT, R0, 0x1, PT
IMAD.MOV R2, RZ, RZ, -R2
IADD3 R7, R7, 0x1, RZ
ISETP.GE.AND P0, PT, R7, R2, PT
@!P1 BRA 0xe0
MOV R2, R0
IADD3 R2, R2, -0x1, RZ
ISETP.NE.AND P1, PT, R2, RZ, PT
@P1 BRA 0xb0
{behind}
@!P0 BRA 0x50
EXIT
"""


def findings(before: str, behind: str) -> list[str]:
    lines = LOOP.strip().format(before=before, behind=behind).splitlines()
    text = "\n".join(f"        /*{16 * i:04x}*/      {line} ;" for i, line in enumerate(lines))
    return list(check_machine_code.Kernel(check_machine_code.read(text)).findings())


def test_a_bound_that_the_first_turn_lacks_is_found() -> None:
    (found,) = findings("NOP", "IMAD.MOV.U32 R2, RZ, RZ, R5")
    assert found.startswith("0x60 IMAD.MOV R2, RZ, RZ, -R2; then 0xe0 IMAD.MOV.U32 R2, RZ, RZ, R5; at first: LDC.64 R2")


def test_a_bound_that_the_first_turn_has_is_right() -> None:
    assert not findings("MOV R2, R5", "IMAD.MOV.U32 R2, RZ, RZ, R5")


def test_a_value_of_the_turn_before_is_right() -> None:
    assert not findings("NOP", "LDS R2, [R7]")
    assert not findings("NOP", "IMAD R2, R7, R5, RZ")
