#!/usr/bin/env bash
# nvidia-cuda-nvcc 13.5.37 (ptxas; no GPU is needed): a loop that finds its bound anew in each turn, as -(a * b), begins with a wrong one.
# Believed: the machine code of -O3 does what the PTX says. Seen: `row < -(a * b)` at the end of a turn becomes a negation at the begin
# of the turn, of a register that only its end writes. The first turn negates what the register held before, half of an address here: where
# that is positive, one turn is done instead of 12. ptxas 12.1 to 13.5 does so from -O1 on, for sm_75 to sm_121; 12.0.140 and -O0 do not.
# nvcc writes such PTX by itself, where a bound kept in front of a loop would take registers: float64 gradients of an image warp, whose
# loops end at -floor(-2 * x), were wrong by a factor of a thousand.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet nvidia-cuda-nvcc==13.5.37 nvidia-cuda-nvdisasm==13.5.37
"$folder/venv/bin/python" - "$folder" <<'PROGRAM'
import glob
import os
import re
import subprocess
import sys

PTX = """
.version 7.8
.target sm_90
.address_size 64
.visible .entry count(.param .u64 from, .param .u64 to)
{
  .reg .pred %p<4>;
  .reg .b32 %r<7>;
  .reg .b64 %rd<3>;
  ld.param.u64 %rd1, [from];
  ld.param.u64 %rd2, [to];
  ld.global.u32 %r1, [%rd1];    // a = 3, say
  ld.global.u32 %r2, [%rd1+4];  // b = -4
  mov.u32 %r3, 0;
  mov.u32 %r6, 0;
ROW:
  mov.u32 %r4, %r1;
  setp.lt.s32 %p1, %r1, 1;
  @%p1 bra NEXT;
COLUMN:
  .pragma "nounroll";
  add.s32 %r6, %r6, %r4;
  add.s32 %r4, %r4, -1;
  setp.ne.s32 %p2, %r4, 0;
  @%p2 bra COLUMN;
NEXT:
  mul.lo.s32 %r5, %r1, %r2;
  neg.s32 %r5, %r5;
  add.s32 %r3, %r3, 1;
  setp.lt.s32 %p3, %r3, %r5;    // row < -(a * b)
  @%p3 bra ROW;
  st.global.u32 [%rd2], %r3;
  st.global.u32 [%rd2+4], %r6;
  ret;
}
"""
folder = sys.argv[1]
tools = glob.glob(f"{folder}/venv/lib/python3*/site-packages/nvidia/cu13/bin")[0]
with open(f"{folder}/count.ptx", "w") as file:
    file.write(PTX)
subprocess.run([f"{tools}/ptxas", "-O3", "-arch=sm_90", f"{folder}/count.ptx", "-o", f"{folder}/count.cubin"], check=True)
text = subprocess.run([f"{tools}/nvdisasm", "-c", f"{folder}/count.cubin"], capture_output=True, text=True, check=True).stdout
code = re.findall(r"^(\.L_x_\d+:)|/\*[0-9a-f]{4}\*/ +(.*?) ;", text, re.M)
code = [label or instruction for label, instruction in code]
code = code[: code.index("EXIT") + 1]
print(*code, sep="\n")

negation = next(i for i, one in enumerate(code) if re.match(r"IMAD\.MOV R\d+, RZ, RZ, -R\d+", one))
register = int(code[negation].rsplit("R", 1)[1])
written = {}  # by whom, as of the first turn: nothing branches in front of the negation
for one in code[:negation]:
    assert "BRA" not in one
    if result := re.match(r"([A-Z][\w.]*) R(\d+),", one):
        for half in range(2 if ".64" in result[1] else 1):
            written[int(result[2]) + half] = one
print(f"\nThe first turn compares with -R{register}, where {written.get(register, 'nothing')} has written.")
assert "IMAD" not in written.get(register, ""), "it is the product now"
assert any(re.match(rf"\S*MOV\S* R{register},|IMAD R{register},", one) for one in code[negation + 1 :])
PROGRAM
