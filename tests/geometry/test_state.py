"""State dicts of rotations, motions, quaternions, lines and planes, and which of their tensors need gradients."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor, nn

import kvision as K
from kvision.geometry.liegroup import Se2, Se3, Sim3, So2, So3

G = K.geometry
GROUPS = (So2, So3, Se2, Se3, Sim3)
SIZES = {So2: (), So3: (3,), Se2: (3,), Se3: (6,), Sim3: (7,)}


def rand(*shape: int, seed: int = 3) -> Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed))


# What each class is made of, from random tensors, in kvision or in Kornia.
OBJECTS: dict[str, tuple[Callable[[Any, int], nn.Module], list[str]]] = {
    "So2": (lambda g, s: g.liegroup.So2.exp(rand(2, seed=s)), ["_z"]),
    "So3": (lambda g, s: g.liegroup.So3.exp(rand(2, 3, seed=s)), ["_q._data"]),
    "Se2": (lambda g, s: g.liegroup.Se2.exp(rand(2, 3, seed=s)), ["_translation", "_rotation._z"]),
    "Se3": (lambda g, s: g.liegroup.Se3.exp(rand(2, 6, seed=s)), ["_translation", "_rotation._q._data"]),
    "Quaternion": (lambda g, s: g.quaternion.Quaternion(rand(2, 4, seed=s)), ["_data"]),
    "ParametrizedLine": (
        lambda g, s: g.line.ParametrizedLine(rand(2, 3, seed=s), rand(2, 3, seed=s + 1)),
        ["_origin", "_direction"],
    ),
    "Hyperplane": (
        lambda g, s: g.plane.Hyperplane(g.vector.Vector3(rand(2, 3, seed=s)), g.vector.Scalar(rand(2, seed=s + 1))),
        ["_n", "_d"],
    ),
}


@pytest.mark.parametrize("name", OBJECTS)
def test_state_dicts_are_those_of_kornia(name: str) -> None:
    theirs = pytest.importorskip("kornia").geometry
    make, keys = OBJECTS[name]
    saved, other, fresh = make(G, 0), make(theirs, 0), make(G, 5)
    assert list(saved.state_dict()) == list(other.state_dict()) == keys
    fresh.load_state_dict(saved.state_dict())
    assert all(torch.equal(x, y) for x, y in zip(fresh.state_dict().values(), saved.state_dict().values()))
    fresh.load_state_dict(other.state_dict())
    for key, x in other.state_dict().items():
        torch.testing.assert_close(fresh.state_dict()[key], x)
    other.load_state_dict(saved.state_dict())


@pytest.mark.parametrize("name", OBJECTS)
def test_members_of_a_graph_are_saved_too(name: str) -> None:
    x = rand(2, 6).requires_grad_()
    quaternion = G.Quaternion(x[:, :4])
    made = {
        "So2": lambda: So2.exp(x[:, 0]),
        "So3": lambda: So3(quaternion),
        "Se2": lambda: Se2.exp(x[:, :3]),
        "Se3": lambda: Se3(quaternion, x[:, :3]),
        "Quaternion": lambda: quaternion,
        "ParametrizedLine": lambda: G.ParametrizedLine(x[:, :3], x[:, 3:]),
        "Hyperplane": lambda: G.Hyperplane(x[:, :3], x[:, 3]),
    }[name]()
    assert list(made.state_dict()) == OBJECTS[name][1] and not list(made.parameters())
    for tensor in made.buffers():
        (grad,) = torch.autograd.grad(tensor.real.sum(), x, retain_graph=True)
        assert grad.any()


@pytest.mark.parametrize("group", GROUPS)
def test_constructors_hold_parameters(group: Any) -> None:
    made = {
        "exp": group.exp(rand(2, *SIZES[group])),
        "identity": group.identity(2),
        "random": group.random(2),
        "from_matrix": group.from_matrix(group.random(2).matrix().detach()),
    }
    if group is Se3:
        qxyz = rand(2, 7)
        made |= {"from_qxyz": Se3.from_qxyz(qxyz), "trans": Se3.trans(*rand(3, 2)), "rot_x": Se3.rot_x(rand(2))}
        made["from_rt"] = G.NamedPose.from_rt(So3.random(2), rand(2, 3)).pose
        made["constructor"] = Se3(G.Quaternion.identity(2), rand(2, 3))
    if group is So3:
        made |= {"from_wxyz": So3.from_wxyz(rand(2, 4)), "rot_z": So3.rot_z(rand(2))}
    if group is Se2:
        made |= {"trans_x": Se2.trans_x(rand(2)), "constructor": Se2(So2.random(2), rand(2, 2))}
    for name, element in made.items():
        parameters = dict(element.named_parameters())
        assert list(parameters) == list(element.state_dict()), name
        assert all(p.requires_grad for p in parameters.values()), name
        element.matrix().square().sum().backward()
        assert all(p.grad is not None for p in parameters.values()), name


def test_training_does_not_write_to_the_matrix_a_pose_was_made_of() -> None:
    for pose, source in ((Se3.from_matrix(matrix := torch.eye(4)), matrix), (Se3.from_qxyz(q := torch.ones(7)), q)):
        before = source.clone()
        with torch.no_grad():
            for p in pose.parameters():
                p.add_(1)
        assert torch.equal(source, before)


def needs_gradient(element: nn.Module) -> bool:
    return any(x.requires_grad for x in (*element.parameters(), *element.buffers()))


@pytest.mark.parametrize("group", GROUPS)
def test_results_need_a_gradient_where_their_operands_do(group: Any) -> None:
    v = rand(2, *SIZES[group])
    constant, other = (group.random(2).requires_grad_(False) for _ in range(2))
    operations: list[Callable[[Any], nn.Module]] = [
        lambda g: g.inverse(),
        lambda g: g * other,
        lambda g: other * g,
        lambda g: g[0],
        lambda g: g.retract(v),
        lambda g: g.interpolate(other, 0.3),
        lambda g: other.interpolate(g, 0.3),
    ]
    for operation in operations:
        assert not needs_gradient(operation(constant))
        assert needs_gradient(operation(group.random(2)))
        with torch.no_grad():
            assert not needs_gradient(operation(constant))
    assert needs_gradient(constant.retract(v.clone().requires_grad_()))
    with torch.no_grad():  # one step of a solver; an optimizer can go on from here
        assert all(p.requires_grad for p in group.random(2).retract(v).parameters())


def test_a_rotation_that_is_held_gives_no_gradient_to_results() -> None:
    pose = Se3.random(2)
    pose.r.requires_grad_(False)
    inverse = pose.inverse()
    assert not needs_gradient(inverse.r) and inverse.t.requires_grad


class Model(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.pose, self.plane = Se3.random(), G.Hyperplane(rand(3), rand(1)[0])
        self.learned = G.Quaternion(nn.Parameter(rand(4)))


def test_files_of_0_1_0() -> None:
    model = Model()
    state = model.state_dict()
    assert list(state) == ["pose._translation", "pose._rotation._q._data", "plane._n", "plane._d", "learned._data"]
    # Parameters were saved under the names of attributes, everything else but translations was not.
    old = {"pose._translation": rand(3), "learned.data": rand(4, seed=9)}
    with pytest.raises(
        RuntimeError, match=r"(?s)Missing key.*\"pose._rotation._q._data\".*\" of Quaternion: files of kvision 0.1.0"
    ):
        model.load_state_dict(old)
    rotation = model.pose.quaternion.data.detach().clone()
    with pytest.warns(UserWarning, match="kvision 0.1.0 may lack") as caught:
        missing = model.load_state_dict(old, strict=False).missing_keys
    assert missing == ["pose._rotation._q._data", "plane._n", "plane._d"] and len(caught) == 3
    assert torch.equal(model.learned.data, old["learned.data"]) and torch.equal(model.pose.quaternion.data, rotation)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model.load_state_dict({**state, "other": rand(1)}, strict=False)
    assert "learned.data" in old
