#!/usr/bin/env bash
# torchdata 0.11.0 with torch 2.13.0: a StatefulDataLoader that is resumed in mid-epoch repeats the augmentations of the epoch's start.
# Believed: load_state_dict continues the epoch as if it had not been interrupted. Seen: the order of the samples continues exactly, but workers
# seed torch's generator as at the epoch's begin: batches 5 to 8 get the random numbers that batches 1 to 4 had, instead of
# their own, so that a dataset that augments gives other images than the run that was not interrupted.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet torchdata==0.11.0 torch==2.13.0 numpy==2.4.6
"$folder/venv/bin/python" - "$folder" <<'PROGRAM'
import torch
from torchdata.stateful_dataloader import StatefulDataLoader


class Numbers(torch.utils.data.Dataset):
    def __len__(self):
        return 16

    def __getitem__(self, index):
        return index, torch.rand(()).item()


def loader():
    torch.manual_seed(1)
    order = torch.Generator().manual_seed(0)
    return StatefulDataLoader(Numbers(), batch_size=2, shuffle=True, num_workers=1, generator=order)


whole, batches, state = loader(), [], None
for batch in whole:
    batches.append(batch)
    if len(batches) == 4:
        state = whole.state_dict()
resumed = loader()
resumed.load_state_dict(state)
rest = list(resumed)
order = [[b[0].tolist() for b in part] for part in (batches[4:], rest)]
numbers = [[[round(v, 4) for v in b[1].tolist()] for b in part] for part in (batches[:4], batches[4:], rest)]
print("samples of batches 5 to 8", *order, sep="\n  not interrupted, resumed: ")
print("numbers of batches 1 to 4:", numbers[0])
print("numbers of batches 5 to 8, not interrupted:", numbers[1])
print("numbers of batches 5 to 8, resumed:", numbers[2])
assert order[0] == order[1] and numbers[2] == numbers[0] != numbers[1]
PROGRAM
