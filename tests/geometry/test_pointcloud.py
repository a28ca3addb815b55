"""Files of point clouds."""

import math

import pytest
import torch

from kvision.geometry.pointcloud import (
    load_pointcloud_ply,
    load_pointcloud_ply_binary,
    save_pointcloud_ply,
    save_pointcloud_ply_binary,
)
from op_tests import assert_close

WRITERS = [(save_pointcloud_ply, load_pointcloud_ply), (save_pointcloud_ply_binary, load_pointcloud_ply_binary)]


@pytest.mark.parametrize("save, load", WRITERS, ids=["text", "binary"])
@pytest.mark.parametrize("shape", [(7, 3), (2, 4, 5, 3), (0, 3), (3,)])
def test_point_clouds_come_back(save, load, shape, tmp_path, device):
    points = torch.randn(shape)
    if points.numel() > 6:
        points.view(-1)[:3] = torch.tensor([math.nan, math.inf, 1e-40])
    save(tmp_path / "cloud.PLY", points.to(device))
    assert_close(load(tmp_path / "cloud.PLY"), points.reshape(-1, 3))


@pytest.mark.parametrize("i", [0, 1])
def test_point_clouds_are_those_of_kornia(i, tmp_path):
    theirs = pytest.importorskip("kornia").geometry.pointcloud
    save, load = WRITERS[i]
    points, path = torch.randn(9, 3), str(tmp_path / "cloud.ply")
    getattr(theirs, save.__name__)(path, points)
    assert_close(load(path), points)
    save(path, points)
    assert_close(getattr(theirs, load.__name__)(path), points)


@pytest.mark.parametrize("save, load", WRITERS, ids=["text", "binary"])
def test_colors_come_back(save, load, tmp_path, device):
    points, rgb = torch.randn(2, 5, 3, device=device), torch.randint(256, (2, 5, 3), device=device, dtype=torch.uint8)
    path = tmp_path / "cloud.ply"
    for colors in (rgb, rgb / 255):
        save(path, points, colors)
        xyz, back = load(path, return_colors=True)
        assert_close(xyz, points.cpu().reshape(-1, 3))
        assert back.dtype == torch.uint8 and torch.equal(back, rgb.cpu().reshape(-1, 3))
        assert_close(load(path), xyz)
    save(path, points[:0], rgb[:0])
    assert [x.shape for x in load(path, return_colors=True)] == [(0, 3), (0, 3)]
    save(path, points)
    assert load(path, return_colors=True)[1] is None
    with pytest.raises(ValueError, match=rf"{save.__name__}: expected colors of shape \(2, 5, 3\), got \(5, 3\)"):
        save(path, points, rgb[0])


def test_colors_of_others(tmp_path):
    """Before the points, in another order, as 16-bit numbers."""
    header = "ply\nformat {} 1.0\nelement vertex 2\n" + "".join(
        f"property ushort {c}\n" for c in ("blue", "red", "green")
    )
    header += "".join(f"property float {c}\n" for c in "xyz") + "end_header\n"
    path, expected = tmp_path / "cloud.ply", torch.tensor([[2, 3, 1], [500, 600, 65535]])
    path.write_text(header.format("ascii") + "1 2 3 0 0 0\n65535 500 600 1 1 1\n")
    colors = load_pointcloud_ply(path, return_colors=True)[1]
    assert colors.dtype == torch.uint16 and torch.equal(colors.long(), expected)
    import struct

    for order, mark in (("little", "<"), ("big", ">")):
        rows = b"".join(struct.pack(mark + "3H3f", b, r, g, 0, 0, 0) for r, g, b in expected.tolist())
        path.write_bytes(header.format(f"binary_{order}_endian").encode() + rows)
        colors = load_pointcloud_ply_binary(path, return_colors=True)[1]
        assert colors.dtype == torch.uint16 and torch.equal(colors.long(), expected)


def test_point_clouds_of_others(tmp_path):
    """Other types, orders, elements and byte orders; faces after the vertices."""
    header = (
        "ply\nformat {} 1.0\ncomment by hand\nelement camera 1\nproperty float f\nelement vertex 2\nproperty uchar red\n"
        "property float z\nproperty short x\nproperty double y\nelement face 1\nproperty list uchar int i\nend_header\n"
    )
    path, expected = tmp_path / "mesh.ply", torch.tensor([[2.0, 3, 1], [-5, 0.25, 4]])
    path.write_text(header.format("ascii") + "0.5\n255 1 2 3\n0 4 -5 0.25\n3 0 1 1\n")
    assert_close(load_pointcloud_ply(path), expected)
    import struct

    for order, mark in (("little", "<"), ("big", ">")):
        rows = struct.pack(mark + "f", 0.5) + b"".join(
            struct.pack(mark + "Bfhd", 7, z, int(x), y) for x, y, z in expected
        )
        path.write_bytes(header.format(f"binary_{order}_endian").encode() + rows + b"\x03")
        assert_close(load_pointcloud_ply_binary(path), expected)


def test_bad_point_clouds(tmp_path):
    path = tmp_path / "bad.ply"
    save_pointcloud_ply(path, torch.ones(2, 3))
    text = path.read_text()
    with pytest.raises(ValueError, match="expected a file of format binary"):
        load_pointcloud_ply_binary(path)
    for bad in (
        "",
        text.replace("ply", "plz"),
        text[:40],
        text[:-4],
        text.replace("1.0 1.0 1.0\n", ""),
        text.replace(" y", " q"),
    ):
        path.write_text(bad)
        with pytest.raises(ValueError, match="load_pointcloud_ply: expected"):
            load_pointcloud_ply(path)
    for bad in ("property float", "element vertex -1", "property list uchar int i\nelement x 1", "what"):
        path.write_text(text.replace("end_header", bad + "\nend_header"))
        with pytest.raises(ValueError, match="load_pointcloud_ply: expected"):
            load_pointcloud_ply(path)
    with pytest.raises(TypeError, match="expected filename to be a str or a path, got int"):
        save_pointcloud_ply(3, torch.ones(2, 3))
    with pytest.raises(ValueError, match=r"expected filename to end in \.ply"):
        save_pointcloud_ply("cloud.txt", torch.ones(2, 3))
    with pytest.raises(ValueError, match=r"pointcloud of shape \(\*, 3\)"):
        save_pointcloud_ply(path, torch.ones(2, 4))
