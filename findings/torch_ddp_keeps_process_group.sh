#!/usr/bin/env bash
# torch 2.13.0: a process group outlives destroy_process_group once DistributedDataParallel was made, even when the model is long gone.
# Believed: destroy_process_group ends the group and its threads. Seen: DistributedDataParallel imports torch.distributed.nn, whose
# functions take the group of that moment as their default argument and keep it for ever. A gloo thread that still runs while Python
# ends can then abort a process whose work is done (seen once in some fifty runs). If torch.distributed.nn is imported before the group
# exists, the group is gone as believed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet torch==2.13.0 numpy==2.4.6
cat > "$folder/program.py" <<'PROGRAM'
import gc
import sys
import weakref

import torch
import torch.distributed as dist

model, early = sys.argv[1:]
if early == "early":
    import torch.distributed.nn
dist.init_process_group("gloo", store=dist.HashStore(), rank=0, world_size=1)
group = weakref.ref(dist.group.WORLD)
if model == "ddp":
    torch.nn.parallel.DistributedDataParallel(torch.nn.Linear(3, 3))
gc.collect()
dist.destroy_process_group()
gc.collect()
print("alive" if group() else "gone")
PROGRAM
run() { "$folder/venv/bin/python" "$folder/program.py" "$@"; }
none=$(run none late) late=$(run ddp late) early=$(run ddp early)
echo "the group after destroy_process_group: without a model $none, with one $late, with torch.distributed.nn imported first $early"
[ "$none $late $early" = "gone alive gone" ]
