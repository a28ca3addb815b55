"""Volumes and their affine matrices.

Volumes are (B, C, D, H, W), points and matrices (x, y, z), and a voxel's coordinates are those of its center, the first one's 0.
`warp_affine3d` takes the matrix from the voxels of the volume to those of the result.
"""

import numpy as np
import torch

import kvision as K
from interchange.rows import noise, row, same

G = K.geometry
# Axes (D, H, W) = (z, y, x), and an oblique affine in RAS with voxels of 1.5 x 2 x 3 mm.
VOLUME = noise(5, 6, 7)
TURN = G.axis_angle_to_rotation_matrix(torch.tensor([[0.1, -0.2, 0.3]], dtype=torch.float64))[0]
RAS = G.affine_from_spacing(torch.tensor([1.5, 2, 3]).double(), torch.tensor([-4, 5, -6.0]).double(), TURN)
OTHER = G.affine_from_spacing(torch.tensor([2.0, 1.5, 2.5]).double(), torch.tensor([-2, 6, -4.0]).double(), TURN)
SIZE = (4, 5, 6)


def resampled() -> torch.Tensor:
    matrix = G.voxel_transform(RAS[None], OTHER[None])[:, :3]
    return G.warp_affine3d(torch.from_numpy(VOLUME).double()[None, None], matrix, SIZE)


def inside() -> np.ndarray:
    """The voxels of the result whose eight neighbors in the volume are there: libraries differ beyond."""
    ones = torch.ones(1, 1, *VOLUME.shape, dtype=torch.float64)
    matrix = G.voxel_transform(RAS[None], OTHER[None])[:, :3]
    found = G.warp_affine3d(ones, matrix, SIZE)[0, 0].numpy() > 1 - 1e-9
    assert found.sum() > 10
    return found


def itk_image(SimpleITK, array, affine):
    """An image of SimpleITK, whose patient is in LPS."""
    spacing, origin, direction = G.affine_to_spacing(G.affine_ras_to_lps(affine))
    image = SimpleITK.GetImageFromArray(array)
    image.SetSpacing(spacing.tolist())
    image.SetOrigin(origin.tolist())
    image.SetDirection(direction.flatten().tolist())
    return image


@row("nibabel", "arrays are (x, y, z), z last", "`torch.from_numpy(array.transpose(2, 1, 0))[None, None]`")
def test_nibabel_axes(nibabel):
    image = nibabel.Nifti1Image(VOLUME.transpose(2, 1, 0), RAS.numpy())
    assert same(image.header.get_zooms(), [1.5, 2, 3])
    back = nibabel.Nifti1Image.from_bytes(image.to_bytes())
    assert same(back.get_fdata().transpose(2, 1, 0), VOLUME)


@row(
    "nibabel",
    "`affine`: from voxels (x, y, z), the first one's center at 0, to RAS in millimeters",
    "`transform_points(affine, voxels)`",
)
def test_nibabel_affine(nibabel):
    assert nibabel.aff2axcodes(np.eye(4)) == ("R", "A", "S")
    points = torch.tensor([[[0.0, 0, 0], [6, 1, 2]]], dtype=torch.float64)
    assert same(nibabel.affines.apply_affine(RAS.numpy(), points[0].numpy()), G.transform_points(RAS[None], points))


@row("nibabel", "`affines.voxel_sizes`: the lengths of the columns", "the spacing of `affine_to_spacing`")
def test_nibabel_spacing(nibabel):
    assert same(nibabel.affines.voxel_sizes(RAS.numpy()), G.affine_to_spacing(RAS)[0])


@row(
    "nibabel",
    "`resample_from_to(image, (shape, affine), order=1)`: linear, 0 outside",
    "`warp_affine3d(x, voxel_transform(affine, other)[:, :3], size)`, in the interior",
)
def test_nibabel_resampling(nibabel):
    from nibabel.processing import resample_from_to

    image = nibabel.Nifti1Image(VOLUME.transpose(2, 1, 0), RAS.numpy())
    theirs = resample_from_to(image, (SIZE[::-1], OTHER.numpy()), order=1).get_fdata().transpose(2, 1, 0)
    assert same(theirs[inside()], resampled()[0, 0].numpy()[inside()])


@row(
    "SimpleITK",
    "`GetArrayFromImage` is (z, y, x); sizes, spacing and origin are (x, y, z)",
    "`torch.from_numpy(array)[None, None]`",
)
def test_itk_axes(SimpleITK):
    image = itk_image(SimpleITK, VOLUME, RAS)
    assert image.GetSize() == VOLUME.shape[::-1] and same(image.GetSpacing(), [1.5, 2, 3])
    assert same(SimpleITK.GetArrayFromImage(image), VOLUME)


@row(
    "SimpleITK",
    "spacing, origin and direction (columns) take voxels, the first one's center at 0, to LPS in millimeters",
    "`affine_from_spacing(spacing, origin, direction)`, `affine_to_spacing`",
)
def test_itk_affine(SimpleITK):
    image = itk_image(SimpleITK, VOLUME, RAS)
    parts = (torch.tensor(x, dtype=torch.float64) for x in (image.GetSpacing(), image.GetOrigin()))
    lps = G.affine_from_spacing(*parts, torch.tensor(image.GetDirection(), dtype=torch.float64).view(3, 3))
    voxel = torch.tensor([[[6.0, 1, 2]]], dtype=torch.float64)
    assert same(image.TransformIndexToPhysicalPoint([6, 1, 2]), G.transform_points(lps[None], voxel))
    assert same(image.TransformContinuousIndexToPhysicalPoint([0.5, 0, 0]), (lps @ lps.new_tensor([0.5, 0, 0, 1]))[:3])


@row(
    "SimpleITK",
    "NIfTI files, which are in RAS, are read in LPS: x and y change their sign",
    "`affine_ras_to_lps`, both ways",
)
def test_itk_of_nifti(SimpleITK):
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = f"{folder}/volume.nii"
        SimpleITK.WriteImage(itk_image(SimpleITK, VOLUME, RAS), path)
        header = np.fromfile(path, np.uint8, 348)
        assert same(header[280:328].view("<f4").reshape(3, 4), RAS[:3], 1e-4)  # srow_x, srow_y, srow_z
        read = SimpleITK.ReadImage(path)
    assert same(read.GetOrigin(), G.affine_ras_to_lps(RAS)[:3, 3], 1e-4)


@row(
    "SimpleITK",
    "`Resample(image, reference)`: linear, on the voxels of the reference, 0 outside",
    "`warp_affine3d(x, voxel_transform(affine, other)[:, :3], size)`, in the interior",
)
def test_itk_resampling(SimpleITK):
    reference = itk_image(SimpleITK, np.zeros(SIZE, np.float32), OTHER)
    theirs = SimpleITK.GetArrayFromImage(SimpleITK.Resample(itk_image(SimpleITK, VOLUME, RAS), reference))
    assert same(theirs[inside()], resampled()[0, 0].numpy()[inside()])


@row(
    "SciPy",
    "`affine_transform` of volumes: result to volume, in (z, y, x)",
    "`warp_affine3d` of the inverse, axes in reverse",
)
def test_scipy(scipy):
    import scipy.ndimage

    back = torch.linalg.inv(G.voxel_transform(RAS, OTHER))
    matrix, offset = back[:3, :3].flip(0, 1).numpy(), back[:3, 3].flip(0).numpy()
    theirs = scipy.ndimage.affine_transform(VOLUME, matrix, offset, SIZE, order=1)
    assert same(theirs[inside()], resampled()[0, 0].numpy()[inside()])


@row(
    "torch",
    "`grid_sample` of volumes: coordinates (x, y, z) from -1 to 1, x along the last axis",
    "`normal_transform_pixel3d` takes (x, y, z), `normalize_pixel_coordinates3d` (z, x, y), for `align_corners=True`",
)
def test_torch(torch_):
    voxels = torch.tensor([[6.0, 1, 2], [3, 5, 4]])
    grid = G.transform_points(G.normal_transform_pixel3d(*VOLUME.shape), voxels[None])
    zxy = G.normalize_pixel_coordinates3d(voxels[:, [2, 0, 1]], *VOLUME.shape)
    assert same(grid, zxy[:, [1, 2, 0]])
    read = torch_.nn.functional.grid_sample(
        torch.from_numpy(VOLUME)[None, None], grid[:, :, None, None], align_corners=True
    )
    assert same(read, [VOLUME[2, 1, 6], VOLUME[4, 5, 3]])


@row(
    "scikit-image",
    "`resize` of volumes: (z, y, x), edges in place",
    "`Resize3D(size, align_corners=False)`",
)
def test_skimage(skimage):
    theirs = skimage.transform.resize(VOLUME, (10, 12, 14), order=1, anti_aliasing=False, mode="edge")
    ours = K.augmentation.Resize3D((10, 12, 14), align_corners=False)(torch.from_numpy(VOLUME)[None, None])
    assert same(theirs, ours)
