// Points and normals of depth images: schemas and entries, for CPU and CUDA.
#include "geometry/depth/points.h"
#include "geometry/transform/sampling_glue.h"

namespace kv::geometry {
namespace {

// Cameras (B, 3, 3), one for each image or one for all, each contiguous.
Tensor cameras_of(char const* op, Tensor const& camera, Tensor const& image) {
  KV_CHECK(matches_image(camera, image, 3) && camera.size(1) == 3 && camera.size(2) == 3, op,
           ": camera does not fit the images");
  return camera.stride(1) == 3 && camera.stride(2) == 1 ? camera : dense(camera);
}
int64_t stride_of(Tensor const& cameras) { return cameras.size(0) == 1 ? 0 : cameras.stride(0); }

template <class T>
DepthPoints<T> points_of(Tensor const& depth, Tensor const& y, Tensor const& cameras, bool distance) {
  int64_t const batch = depth.size(0);
  return {images<T const>(depth, batch), images<T>(y, batch), data_ptr<Compute<T> const>(cameras), stride_of(cameras),
          distance};
}

Tensor checked(char const* op, Tensor const& depth, Tensor const& camera) {
  check_images(op, "depth", depth);
  KV_CHECK(depth.size(1) == 1, op, ": expected depth of shape (B, 1, H, W), got ", depth.size(1), " channels");
  checked_size(op, depth);
  return cameras_of(op, camera, depth);
}

// Three channels (B, 3, H, W), or (B, H, W, 3) with coordinates last.
Tensor depth_points(Tensor const& depth, Tensor const& camera, bool distance, bool last) {
  Tensor const cameras = checked("depth_points", depth, camera);
  int64_t const batch = depth.size(0), h = depth.size(2), w = depth.size(3);
  Tensor const y = last ? empty({batch, h, w, 3}, depth) : empty({batch, 3, h, w}, depth);
  dispatch_floating("depth_points", depth, [&](auto type) {
    using T = typename decltype(type)::type;
    auto params = points_of<T>(depth, y, cameras, distance);
    if (last) params.y = {data_ptr<T>(y), 3 * h * w, 1, 3 * w, 3, batch, h, w, 3};
    KV_RUN(depth_points, depth, params, params.y.batch * params.y.height, 4 * params.y.width);
  });
  return y;
}

Tensor depth_points_backward(Tensor const& grad, Tensor const& camera, bool distance) {
  char const* const op = "depth_points_backward";
  check_images(op, "grad", grad);
  KV_CHECK(grad.size(1) == 3, op, ": expected grad of shape (B, 3, H, W), got ", grad.size(1), " channels");
  checked_size(op, grad);
  Tensor const cameras = cameras_of(op, camera, grad);
  int64_t const batch = grad.size(0);
  Tensor const grad_depth = empty({batch, 1, grad.size(2), grad.size(3)}, grad);
  dispatch_floating(op, grad, [&](auto type) {
    using T = typename decltype(type)::type;
    DepthPointsBackward<T> const params{images<T const>(grad, batch), images<T>(grad_depth, batch),
                                        data_ptr<Compute<T> const>(cameras), stride_of(cameras), distance};
    KV_RUN(depth_points_backward, grad, params, batch * params.grad.height, 4 * params.grad.width);
  });
  return grad_depth;
}

Tensor depth_normals(Tensor const& depth, Tensor const& camera, bool distance) {
  Tensor const cameras = checked("depth_normals", depth, camera);
  Tensor const y = empty({depth.size(0), 3, depth.size(2), depth.size(3)}, depth);
  dispatch_floating("depth_normals", depth, [&](auto type) {
    auto const params = points_of<typename decltype(type)::type>(depth, y, cameras, distance);
    KV_RUN(depth_normals, depth, params, params.y.batch * params.y.height, 64 * params.y.width);
  });
  return y;
}

// Checks cameras, depth and a gradient of the pixels' points or normals.
Tensor checked_gradient(char const* op, Tensor const& grad, Tensor const& depth, Tensor const& camera) {
  check_images(op, "grad", grad);
  check_images(op, "depth", depth);
  KV_CHECK(grad.size(1) == 3, op, ": expected grad of shape (B, 3, H, W), got ", grad.size(1), " channels");
  check_sizes(op, "depth", depth, grad, {grad.size(0), 1, grad.size(2), grad.size(3)});
  checked_size(op, grad);
  return cameras_of(op, camera, grad);
}

Tensor normals_gradient(char const* op, Tensor const& grad, Tensor const& depth, Tensor const& camera, bool distance,
                        bool to_points) {
  Tensor const cameras = checked_gradient(op, grad, depth, camera);
  int64_t const batch = grad.size(0), height = grad.size(2), width = grad.size(3);
  Tensor const to = empty({batch, to_points ? 3 : 1, height, width}, grad);
  dispatch_floating(op, depth, [&](auto type) {
    using T = typename decltype(type)::type;
    DepthNormalsBackward<T> const params{images<T const>(grad, batch),
                                         images<T const>(depth, batch),
                                         images<T>(to, batch),
                                         data_ptr<Compute<T> const>(cameras),
                                         stride_of(cameras),
                                         distance,
                                         to_points};
    KV_RUN(depth_normals_backward, depth, params, batch * params.depth.height, 128 * params.depth.width);
  });
  return to;
}

Tensor depth_normals_backward(Tensor const& grad, Tensor const& depth, Tensor const& camera, bool distance) {
  return normals_gradient("depth_normals_backward", grad, depth, camera, distance, false);
}

// Gradient to points (B, 3, H, W).
Tensor depth_normals_points_backward(Tensor const& grad, Tensor const& depth, Tensor const& camera, bool distance) {
  return normals_gradient("depth_normals_points_backward", grad, depth, camera, distance, true);
}

// The gradient to the camera of each image (B, 3, 3), also if all share one, from the gradient to its points.
Tensor depth_points_camera_backward(Tensor const& grad, Tensor const& depth, Tensor const& camera, bool distance) {
  constexpr char const* op = "depth_points_camera_backward";
  Tensor const cameras = checked_gradient(op, grad, depth, camera);
  int64_t const batch = grad.size(0), height = grad.size(2), width = grad.size(3);
  Tensor const grad_camera = empty({batch, 3, 3}, cameras);
#if defined(KV_CUDA)
  int64_t const parts =
      ((width + 3) / 4 * height + 1023) / 1024;  // a chunk: 256 threads, four groups of four pixels each
#else
  int64_t const parts = height;
#endif
  Tensor const partial = empty({batch, parts, 4}, cameras, Layout::planar, ScalarType::Double);
  dispatch_floating(op, depth, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    DepthPointsCameraBackward<T> const params{images<T const>(grad, batch),
                                              images<T const>(depth, batch),
                                              data_ptr<F const>(cameras),
                                              stride_of(cameras),
                                              distance,
                                              parts,
                                              data_ptr<double>(partial),
                                              data_ptr<F>(grad_camera)};
    KV_RUN(depth_points_camera_backward, depth, params, batch * parts, 8 * width);
#if !defined(KV_CUDA)
    for (int64_t b = 0; b < batch; ++b) {
      double sums[4] = {};
      for (int64_t part = 0; part < parts; ++part)
        for (int k = 0; k < 4; ++k) sums[k] += params.partial[4 * (b * parts + part) + k];
      Rays<F>(params.cameras + b * params.camera_stride, distance).store_gradients(sums, params.grad_camera + 9 * b);
    }
#endif
  });
  return grad_camera;
}

}  // namespace

KV_OPERATOR(depth_points, "(Tensor depth, Tensor camera, bool distance, bool last) -> Tensor")
KV_OPERATOR(depth_points_backward, "(Tensor grad, Tensor camera, bool distance) -> Tensor")
KV_OPERATOR(depth_normals, "(Tensor depth, Tensor camera, bool distance) -> Tensor")
KV_OPERATOR(depth_normals_backward, "(Tensor grad, Tensor depth, Tensor camera, bool distance) -> Tensor")
KV_OPERATOR(depth_normals_points_backward, "(Tensor grad, Tensor depth, Tensor camera, bool distance) -> Tensor")
KV_OPERATOR(depth_points_camera_backward, "(Tensor grad, Tensor depth, Tensor camera, bool distance) -> Tensor")

}  // namespace kv::geometry
