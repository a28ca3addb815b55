"""Published weights of the networks: where they are, how they are checked, and how a network takes them."""

from __future__ import annotations

import hashlib
import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from kvision import _check
from kvision._dtype import is_autocast_on
from kvision.core.exceptions import TypeCheckError


class Checkpoint(NamedTuple):
    url: str
    sha256: str = ""  # empty: not known, which is warned of

    @property
    def file(self) -> Path:
        """Where torch.hub keeps it."""
        return Path(torch.hub.get_dir()) / "checkpoints" / self.url.rpartition("/")[2]


Weights = bool | str | os.PathLike | Mapping[str, Any]

_AFFNET = "https://github.com/ducha-aiki/affnet/raw/master/pretrained"
_HARDNET = "https://github.com/DagnyT/hardnet/raw/master/pretrained"
_KEYNET = "https://github.com/axelBarroso/Key.Net-Pytorch/raw/main/model"
_MKD = "https://github.com/manyids2/mkd_pytorch/raw/master/mkd_pytorch"
PUBLISHED = {
    "HardNet": Checkpoint(f"{_HARDNET}/train_liberty_with_aug/checkpoint_liberty_with_aug.pth"),
    "HardNet8": Checkpoint("https://cmp.felk.cvut.cz/~mishkdmy/hardnet8v2.pt"),
    "HyNet": Checkpoint(f"{_KEYNET}/HyNet/weights/HyNet_LIB.pth"),
    "KeyNet": Checkpoint(
        f"{_KEYNET}/weights/keynet_pytorch.pth", "59d3a46d57b439513acf531877fdfaa95eb550ccd10ec462e23d7c1f7a86d52a"
    ),
    "LAFAffNetShapeEstimator": Checkpoint(
        f"{_AFFNET}/AffNet.pth", "65c8bb2cf71e913818522d09dcc4262bcbcef5d756baa86a41f28526c2d61160"
    ),
    "MKDDescriptor-cart": Checkpoint(
        f"{_MKD}/mkd-cart-64.pth", "a9f907bbc0eacd19e31228f839ed12ff6ecbbbfafa2bbde1266788c722c38d56"
    ),
    "MKDDescriptor-concat": Checkpoint(
        f"{_MKD}/mkd-concat-64.pth", "e31112000009e0d6e159dd7726aeea9f6a7d746cfe7d59b59bfb86c570667641"
    ),
    "MKDDescriptor-polar": Checkpoint(f"{_MKD}/mkd-polar-64.pth"),
    "OriNet": Checkpoint(f"{_AFFNET}/OriNet.pth", "030e7964ae3e136d00431c7e11c6b67df40ad299f02ac384fee0f1c3fd1dcb30"),
    "SOSNet": Checkpoint("https://github.com/yuruntian/SOSNet/raw/master/sosnet-weights/sosnet_32x32_liberty.pth"),
    "TFeat": Checkpoint(
        "https://github.com/vbalnt/tfeat/raw/master/pretrained-models/tfeat-liberty.params",
        "1f2e9516b03c45876161da006ce8047e0a66ef08cc91d3fbf96a75f1a80f445a",
    ),
}


def load_weights(network: nn.Module, pretrained: Weights) -> None:
    """Give a network the weights that its argument `pretrained` names, and set it to evaluation then.

    True: the published ones, downloaded by torch.hub if they are not in its folder. A path: a file of torch.save. A
    mapping: a state dict, or a checkpoint that has one as "state_dict". False: none.
    """
    name = type(network).__name__
    if pretrained is False:
        return
    weights = read_weights(name, name, pretrained)
    state: Mapping[str, Tensor] = weights.get("state_dict", weights)
    try:
        network.load_state_dict(state)
    except RuntimeError as error:
        raise RuntimeError(f"{name}: pretrained has other weights than the network: {error}") from error
    network.eval()


def check_weights(op: str, network: nn.Module, x: Tensor) -> None:
    """Raise unless the weights of a network are where its input is and of its type, which autocast chooses itself."""
    weights = next(network.parameters())
    _check.same_device(op, input=x, weights=weights)
    if weights.dtype != x.dtype and not is_autocast_on(x):
        raise TypeCheckError(f"{op}: expected input of the type of the weights, {weights.dtype}, got {x.dtype}")


def read_weights(name: str, published: str, pretrained: Weights) -> Mapping[str, Any]:
    """What `pretrained` names: the file that is published as `published`, that of a path, or a mapping itself."""
    if pretrained is True:
        return _published(name, published)
    if isinstance(pretrained, (str, os.PathLike)):
        return _read(name, Path(pretrained))
    if isinstance(pretrained, Mapping):
        return pretrained
    raise TypeCheckError(
        f"{name}: expected pretrained to be a bool, a path or a state dict, got {type(pretrained).__name__}",
        actual_type=type(pretrained),
    )


def _published(name: str, published: str) -> Mapping[str, Any]:
    checkpoint = PUBLISHED[published]
    if not checkpoint.file.exists():
        checkpoint.file.parent.mkdir(parents=True, exist_ok=True)
        try:
            torch.hub.download_url_to_file(checkpoint.url, str(checkpoint.file), progress=False)
        except OSError as error:  # urllib's errors are OSErrors
            raise RuntimeError(
                f"{name}: the published weights could not be downloaded ({error}). Put {checkpoint.url} to "
                f"{checkpoint.file}, or pass pretrained= a path, a state dict or False"
            ) from error
    found = hashlib.sha256(checkpoint.file.read_bytes()).hexdigest()
    if not checkpoint.sha256:
        warnings.warn(
            f"{name}: the published weights are unverified, since their checksum is not known: {checkpoint.file} has the "
            f"SHA-256 {found}",
            stacklevel=2,
        )
    elif found != checkpoint.sha256:
        raise RuntimeError(
            f"{name}: {checkpoint.file} is not {checkpoint.url}: its SHA-256 is not {checkpoint.sha256}. Remove it"
        )
    return _read(name, checkpoint.file)


def _read(name: str, path: Path) -> Mapping[str, Any]:
    if not path.is_file():
        raise FileNotFoundError(f"{name}: expected pretrained to be the path of a file, got {path}")
    weights = torch.load(path, map_location="cpu", weights_only=True)
    if not isinstance(weights, Mapping):
        raise TypeCheckError(f"{name}: expected {path} to hold a state dict, got {type(weights).__name__}")
    return weights
