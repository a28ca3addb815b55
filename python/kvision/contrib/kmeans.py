"""K-means clustering of points."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError


class KMeans:
    """Find clusters of points by Lloyd's algorithm: assign points to the nearest center, move centers to their means.

    Args:
        num_clusters: how many, at least 1.
        cluster_centers: first centers (num_clusters, D); None for that many of the points, drawn at random.
        tolerance: stop when the square of the summed movements of the centers is at most this; None for no such limit.
        max_iterations: stop after that many rounds; 0 for no such limit, which needs a tolerance.
        seed: of the generator that draws the first centers and new ones for centers without points, in every fit;
            None for torch's.

    Raises:
        TypeCheckError: arguments of the wrong type.
        ShapeError: cluster_centers of another shape.
        ValueCheckError: num_clusters below 1, a negative tolerance or max_iterations, no limit at all.

    Example:
        >>> import torch, kvision as K
        >>> points = torch.tensor([[0.0], [1.0], [9.0], [11.0]])
        >>> kmeans = K.contrib.KMeans(2, points[:2])
        >>> kmeans.fit(points)
        >>> kmeans.cluster_centers.flatten(), kmeans.predict(torch.tensor([[4.0]]))
        (tensor([ 0.5000, 10.0000]), tensor([0]))
    """

    def __init__(
        self,
        num_clusters: int,
        cluster_centers: Tensor | None,
        tolerance: float | None = 1e-3,
        max_iterations: int = 0,
        seed: int | None = None,
    ) -> None:
        _check.ints("KMeans", "num_clusters", num_clusters, 1)
        _check.ints("KMeans", "max_iterations", max_iterations, 1, 0)
        if tolerance is not None:
            _check.number("KMeans", "tolerance", tolerance, minimum=0)
        elif max_iterations == 0:
            raise ValueCheckError("KMeans: expected a tolerance or max_iterations above 0, got neither")
        if cluster_centers is not None:
            _check.shape("KMeans", "cluster_centers", cluster_centers, num_clusters, "D")
        self.num_clusters, self.tolerance, self.max_iterations = num_clusters, tolerance, max_iterations
        self._first_centers = cluster_centers
        self._centers = cluster_centers
        self._assignments: Tensor | None = None
        self._seed = seed

    @property
    def cluster_centers(self) -> Tensor:
        """The centers (num_clusters, D): those of the last fit, or those passed to the constructor.

        Example:
            >>> import torch, kvision as K
            >>> K.contrib.KMeans(1, torch.zeros(1, 2)).cluster_centers
            tensor([[0., 0.]])
        """
        if self._centers is None:
            raise TypeCheckError("KMeans: cluster_centers are known after fit")
        return self._centers

    @property
    def cluster_assignments(self) -> Tensor:
        """The cluster of every point (N,) of the last fit.

        Example:
            >>> import torch, kvision as K
            >>> kmeans = K.contrib.KMeans(1, None)
            >>> kmeans.fit(torch.rand(3, 2))
            >>> kmeans.cluster_assignments
            tensor([0, 0, 0])
        """
        if self._assignments is None:
            raise TypeCheckError("KMeans: cluster_assignments are known after fit")
        return self._assignments

    def fit(self, X: Tensor) -> None:
        """Find the clusters of points (N, D), N at least 1; with a tolerance every round waits for the device.

        Points that are NaN or infinite are a ValueCheckError; on a GPU only with a tolerance, without which nothing is read.

        Example:
            >>> import torch, kvision as K
            >>> kmeans = K.contrib.KMeans(2, None, seed=0)
            >>> kmeans.fit(torch.rand(10, 3))
            >>> kmeans.cluster_centers.shape
            torch.Size([2, 3])
        """
        _check.shape("KMeans", "X", X, "N", "D")
        if X.shape[0] == 0:
            raise ShapeError("KMeans: expected X with at least one point, got none", actual_shape=X.shape)
        n = self.num_clusters
        generator = None if self._seed is None else torch.Generator(X.device).manual_seed(self._seed)
        centers = self._first_centers
        if centers is None:
            if X.shape[0] < n:
                raise ShapeError(f"KMeans: expected X of at least {n} points, got {tuple(X.shape)}")
            centers = X[torch.randperm(X.shape[0], generator=generator, device=X.device)[:n]]
        self._check_columns(X, centers)
        # With a tolerance every round waits for the device, so this look at the points costs nothing more.
        if (self.tolerance is not None or X.is_cpu) and not X.isfinite().all():
            raise ValueCheckError("KMeans: expected X of finite points, got NaN or infinite ones")
        points, rounds = _promoted(X), 0
        while True:
            nearest = _nearest(X, centers)
            members = torch.zeros(n, X.shape[0], dtype=points.dtype, device=X.device)
            members.scatter_(0, nearest[None], 1)
            counts = members.sum(1, keepdim=True)
            means = members @ points / counts.clamp_min(1)
            spare = points[torch.randint(X.shape[0], (n,), generator=generator, device=X.device)]
            previous, centers = centers, torch.where(counts == 0, spare, means).to(X.dtype)
            rounds += 1
            moved = (_promoted(centers) - _promoted(previous)).norm(dim=1).sum()
            if rounds == self.max_iterations or (self.tolerance is not None and bool(moved**2 <= self.tolerance)):
                break
        self._centers = centers
        self._assignments = _nearest(X, centers)

    def predict(self, x: Tensor) -> Tensor:
        """Find the nearest center (N,) of points (N, D).

        Example:
            >>> import torch, kvision as K
            >>> K.contrib.KMeans(2, torch.tensor([[0.0], [1.0]])).predict(torch.tensor([[0.9]]))
            tensor([1])
        """
        _check.shape("KMeans", "x", x, "N", "D")
        self._check_columns(x, self.cluster_centers)
        return _nearest(x, self.cluster_centers)

    def _check_columns(self, x: Tensor, centers: Tensor) -> None:
        _check.shape("KMeans", "X", x, "N", centers.shape[1])
        _check.same_device("KMeans", X=x, cluster_centers=centers)


def _promoted(x: Tensor) -> Tensor:
    """Convert to the compute dtype: float32 for half types, float64 for integers."""
    if x.is_floating_point():
        return x.to(torch.promote_types(x.dtype, torch.float32))
    return x.double()


def _nearest(x: Tensor, centers: Tensor) -> Tensor:
    dtype = torch.promote_types(_promoted(x).dtype, _promoted(centers).dtype)
    exact = "donot_use_mm_for_euclid_dist"  # the expanded form cancels for points far from 0
    return torch.cdist(x.to(dtype), centers.to(dtype), compute_mode=exact).argmin(1)
