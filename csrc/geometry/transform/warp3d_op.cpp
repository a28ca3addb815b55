// Warps of volumes: schemas and entries, for CPU and CUDA.
#include "geometry/transform/sampling_glue.h"
#include "geometry/transform/warp3d.h"

namespace kv::geometry {
namespace {

Size3 size3_of(char const* op, std::vector<int64_t> const& size) {
  KV_CHECK(size.size() == 3, op, ": expected a size of depth, height and width, got ", size.size(), " numbers");
  for (int64_t side : size)
    KV_CHECK(side > 0 && side <= kLargestSide, op, ": expected a size of 1 to ", kLargestSide, " voxels, got ", side);
  return {size[0], size[1], size[2]};
}

Size3 size3_of(char const* op, Tensor const& x) { return size3_of(op, {x.size(2), x.size(3), x.size(4)}); }

// The voxels of a part of a sample. On the CPU it is a row. On CUDA a block takes it: many, because each computes the
// map of its sample, and few where there would be less than kFewBlocks, which leave most of a GPU idle.
int64_t part_voxels([[maybe_unused]] int64_t batch, Size3 const& output) {
#if defined(KV_CUDA)
  constexpr int64_t kMost = 4096, kFewest = 256, kFewBlocks = 512;
  int64_t const voxels = batch * output.depth * output.height * output.width / kFewBlocks;
  return clamp(voxels / kFewest * kFewest, kFewest, kMost);
#else
  return output.width;
#endif
}
int64_t parts_of(int64_t batch, Size3 const& output) {
  return ceil_div(output.depth * output.height * output.width, part_voxels(batch, output));
}

// A warp of dense volumes like `volumes`, and its parameters; the caller sets the tensors that are read and written.
struct Warp {
  char const* op;
  Tensor volumes;
  WarpMatrix matrix;
  Interpolation interpolation;
  Padding padding;
  MatrixUse3 use;

  Warp(char const* op, Tensor const& volumes, WarpMatrix const& matrix, Size3 source, Size3 output,
       int64_t interpolation, int64_t padding, bool align_corners, bool inverse, bool normalized)
      : op(op),
        volumes(dense(volumes)),
        matrix(matrix),
        interpolation(parse_interpolation(op, interpolation)),
        padding(parse_padding(op, padding)),
        use{matrix.rows, inverse, normalized, align_corners, source, output} {
    KV_CHECK(this->interpolation != Interpolation::bicubic, op, ": interpolation must be 0 (nearest) or 3 (bilinear)");
  }
  int64_t batch() const { return volumes.size(0); }
  int64_t channels() const { return volumes.size(1); }
  template <class T>
  Warp3d<T> of(Tensor const& x, Tensor const& y) const {
    return {interpolation,
            padding,
            matrix.data<Compute<T>>(),
            matrix.stride,
            use,
            data_ptr<T>(x),
            data_ptr<T>(y),
            batch(),
            channels(),
            nullptr,
            parts_of(batch(), use.output),
            part_voxels(batch(), use.output)};
  }
};

Tensor warped_volumes(Warp const& w) {
  Size3 const size = w.use.output;
  Tensor const y = empty({w.batch(), w.channels(), size.depth, size.height, size.width}, w.volumes);
  dispatch_floating(w.op, w.volumes, [&](auto type) {
    using T = typename decltype(type)::type;
    Warp3dForward<T> const params{w.of<T>(w.volumes, y), w.matrix.formula};
    KV_RUN(warp3d, y, params, y.numel() > 0 ? w.batch() * size.depth * size.height : 0, 16 * w.channels() * size.width);
  });
  return y;
}

Tensor warp3d(Tensor const& volumes, Tensor const& matrix, std::vector<int64_t> size, int64_t interpolation,
              int64_t padding, bool align_corners, bool inverse, bool normalized) {
  check_volumes("warp3d", "volumes", volumes);
  return warped_volumes({"warp3d", volumes, WarpMatrix("warp3d", matrix, volumes, 3, volumes.size(0)),
                         size3_of("warp3d", volumes), size3_of("warp3d", size), interpolation, padding, align_corners,
                         inverse, normalized});
}

Tensor warp3d_by_formula(Tensor const& x, std::optional<Tensor> const& a, std::optional<Tensor> const& b,
                         std::optional<Tensor> const& c, std::optional<Tensor> const& d, std::optional<Tensor> const& e,
                         std::optional<Tensor> const& f, int64_t formula, std::vector<double> numbers,
                         std::vector<int64_t> size, int64_t interpolation, int64_t padding, bool align_corners,
                         bool inverse, bool normalized) {
  char const* const op = "warp3d_by_formula";
  check_volumes(op, "volumes", x);
  Size3 const source = size3_of(op, x), output = size3_of(op, size);
  FormulaInputs const inputs{a, b, c, d, e, f};
  auto const run = [&](WarpMatrix const& m) {
    return warped_volumes({op, x, m, source, output, interpolation, padding, align_corners, inverse, normalized});
  };
  int64_t const samples = x.size(0);
  constexpr bool within = true;
  KV_SPACE_FORMULAS(KV_WARP_BY)
  KV_CHECK(false, op, ": no formula of volumes has the number ", formula);
  return x;
}

Tensor warp3d_volume_backward(Tensor const& grad, Tensor const& matrix, std::vector<int64_t> size,
                              int64_t interpolation, int64_t padding, bool align_corners, bool inverse,
                              bool normalized) {
  char const* const op = "warp3d_volume_backward";
  check_volumes(op, "grad", grad);
  Warp const w(op, grad, {op, matrix, grad, 3, grad.size(0)}, size3_of(op, size), size3_of(op, grad), interpolation,
               padding, align_corners, inverse, normalized);
  Tensor const grad_x = empty({w.batch(), w.channels(), size[0], size[1], size[2]}, grad);
  dispatch_compute_dtype(op, grad, [&](auto type) {
    using F = typename decltype(type)::type;
    Warp3dVolumeBackward<F> const params{w.of<F>(grad_x, w.volumes)};
    KV_RUN(warp3d_volume_backward, grad, params, w.batch() * w.channels(), 16 * params.output_voxels());
  });
  return grad_x;
}

Tensor warp3d_matrix_backward(Tensor const& grad, Tensor const& volumes, Tensor const& matrix, int64_t interpolation,
                              int64_t padding, bool align_corners, bool inverse, bool normalized) {
  char const* const op = "warp3d_matrix_backward";
  check_volumes(op, "volumes", volumes);
  check_volumes(op, "grad", grad);
  check_gradient(op, grad, volumes, volumes.size(0));
  Warp const w(op, volumes, {op, matrix, volumes, 3, volumes.size(0)}, size3_of(op, volumes), size3_of(op, grad),
               interpolation, padding, align_corners, inverse, normalized);
  Tensor const y = dense(grad);
  int64_t const parts = parts_of(w.batch(), w.use.output);
  Tensor const sums = empty({w.batch(), parts, 16}, grad, Layout::planar, ScalarType::Double);
  Tensor const grad_matrix = empty({w.batch(), w.use.rows, 4}, w.matrix.tensor);
  dispatch_compute_dtype(op, volumes, [&](auto type) {
    using F = typename decltype(type)::type;
    Warp3dCoordsBackward<F> params{w.of<F>(w.volumes, y)};
    params.sums = data_ptr<double>(sums);
    KV_RUN(warp3d_coords_backward, volumes, params, w.batch() * w.use.output.depth * w.use.output.height,
           32 * w.channels() * w.use.output.width);
    Warp3dMatrixBackward<F> total{w.of<F>(grad_matrix, grad_matrix), data_ptr<F>(grad_matrix)};
    total.sums = params.sums;
    KV_RUN(warp3d_matrix_backward, volumes, total, w.batch(), 16 * parts);
  });
  return grad_matrix;
}

}  // namespace

KV_OPERATOR(warp3d, "(Tensor volumes, Tensor matrix, SymInt[] size, " KV_WARP_OPTIONS ") -> Tensor")
KV_OPERATOR(warp3d_by_formula, "(Tensor volumes, " KV_FORMULA_INPUTS KV_FORMULA_OPTIONS KV_WARP_OPTIONS ") -> Tensor")
KV_OPERATOR(warp3d_volume_backward, "(Tensor grad, Tensor matrix, SymInt[] size, " KV_WARP_OPTIONS ") -> Tensor")
KV_OPERATOR(warp3d_matrix_backward, "(Tensor grad, Tensor volumes, Tensor matrix, " KV_WARP_OPTIONS ") -> Tensor")

}  // namespace kv::geometry
