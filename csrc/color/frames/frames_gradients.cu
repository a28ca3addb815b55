// Gradients to the planes of frames on CUDA, in one launch: a thread gathers those of one sample of a plane. Which
// results may have taken the sample follows from the boxes, or from the matrix that maps its surroundings to the
// result.
#include "frames.cuh"

namespace kv::color::cuda {
namespace {

// From results to the frame, as the forward pass has it, and from the frame to results.
template <class F>
struct MatrixPair {
  F inverse[9];
  double forward[9];

  template <class T>
  __device__ __forceinline__ void set(PlanesToRgb<T> const& p, int64_t frame) {
    double exact[9];
    F const* const m = p.map + frame * p.map_stride;
    invert_up_to_factor(m, p.is_affine, p.from_result, exact);
    for (int k = 0; k < 9; ++k) inverse[k] = F(exact[k]);
    invert_up_to_factor(m, p.is_affine, !p.from_result, forward);
  }
  // The results, of `count`, that may have taken pixels of [first, last) along x and y: those in the image of the
  // rectangle of their positions. All, where that is not bounded.
  template <class T>
  __device__ __forceinline__ void results_of(PlanesToRgb<T> const& p, ResultRange x, ResultRange y,
                                             ResultRange (&results)[2]) const {
    int const counts[] = {int(p.rgb.width), int(p.rgb.height)};
    double least[] = {1e30, 1e30}, most[] = {-1e30, -1e30};
    bool is_bounded = !p.border || (x.first > 0 && x.last < p.x.size && y.first > 0 && y.last < p.y.size);
    bool is_positive = true, is_negative = true;
    for (int corner = 0; corner < 4; ++corner) {
      double const u = corner % 2 ? x.last : x.first - 1, v = corner / 2 ? y.last : y.first - 1;
      double const z = forward[6] * u + forward[7] * v + forward[8];
      is_positive = is_positive && z > 0;
      is_negative = is_negative && z < 0;
      for (int axis = 0; axis < 2; ++axis) {
        double const at = (forward[3 * axis] * u + forward[3 * axis + 1] * v + forward[3 * axis + 2]) / z;
        least[axis] = min(least[axis], at), most[axis] = max(most[axis], at);
      }
    }
    is_bounded = is_bounded && (is_positive || is_negative);
    for (int axis = 0; axis < 2; ++axis)
      results[axis] = is_bounded ? ResultRange{whole_within(::floor(least[axis]) - 1, 0, counts[axis]),
                                               whole_within(::floor(most[axis]) + 3, 0, counts[axis])}
                                 : ResultRange{0, counts[axis]};
  }
};

// The pixels of an axis that may take sample i of a plane.
__device__ __forceinline__ ResultRange takers_of(FrameAxis const& axis, bool is_chroma, int i) {
  return is_chroma && axis.is_halved() ? ResultRange{2 * i - 1, 2 * i + 3} : ResultRange{i, i + 1};
}

template <class T>
__global__ void __launch_bounds__(kRowThreads) run_gradients(__grid_constant__ PlanesToRgbBackward<T> const p) {
  using F = Compute<T>;
  __shared__ MatrixPair<F> matrices;
  PlanesToRgb<T> const& f = p.forward;
  int const x = int(blockIdx.x * 32 + threadIdx.x % 32), row = int(blockIdx.y) * kRowWarps + threadIdx.x / 32;
  int const plane = row < p.height(0) ? 0 : row < p.height(0) + p.height(1) ? 1 : 2;
  int const y = row - (plane ? p.height(0) + (plane - 1) * p.height(1) : 0);
  bool const is_sample = row < p.rows_of_frame() && x < p.width(plane), is_chroma = plane > 0;
  ResultRange const x_takers = takers_of(f.x, is_chroma, x), y_takers = takers_of(f.y, is_chroma, y);
  auto const value = [](T const* at) { return read(*at); };
  for (int64_t frame = blockIdx.z; frame < p.grad.count() / 3; frame += gridDim.z) {
    F sum = 0;
    if (f.kind == FrameMap::matrices) {
      if (threadIdx.x == 0) matrices.set(f, frame);
      __syncthreads();
      if (is_sample) {
        ResultRange results[2];
        matrices.results_of(f, x_takers, y_takers, results);
        for (int j = results[1].first; j < results[1].last; ++j)
          for (int i = results[0].first; i < results[0].last; ++i) {
            Preimage<F> const at(matrices.inverse, F(i), F(j));
            F const of_column = f.window_at(at.x, f.x).plane_weight(is_chroma, f.x, x);
            if (of_column == F(0)) continue;
            F const weight = of_column * f.window_at(at.y, f.y).plane_weight(is_chroma, f.y, y);
            if (weight != F(0)) sum += weight * p.taken(plane, frame, j, i, value);
          }
      }
      __syncthreads();
    } else if (is_sample) {
      BoxAxis<F> const box_x = f.box_axis(frame, false), box_y = f.box_axis(frame, true);
      ResultRange const columns = box_x.results_of(x_takers.first, x_takers.last, int(p.grad.width));
      ResultRange const rows = box_y.results_of(y_takers.first, y_takers.last, int(p.grad.height));
      for (int j = rows.first; j < rows.last; ++j) {
        PixelWindow<F> const wy = box_y.window(j);
        F const of_row = wy.plane_weight(is_chroma, f.y, y);
        if (of_row == F(0)) continue;
        F in_row = 0;
        for (int i = columns.first; i < columns.last; ++i) {
          PixelWindow<F> const wx = box_x.window(i);
          F const of_column = wx.plane_weight(is_chroma, f.x, x);
          if (of_column != F(0)) in_row += of_column / wx.sum() * p.taken(plane, frame, j, i, value);
        }
        sum += of_row / wy.sum() * in_row;
      }
    }
    if (is_sample) p.row(plane, frame, y)[x] = round_to<T>(sum);
  }
}

}  // namespace

template <class T>
int planes_to_rgb_backward(PlanesToRgbBackward<T> const& p, CUstream_st* stream) {
  dim3 const blocks(unsigned(ceil_div(p.width(0), 32)), unsigned(ceil_div(p.rows_of_frame(), kRowWarps)),
                    unsigned(min(p.grad.count() / 3, int64_t(65535))));
  run_gradients<T><<<blocks, kRowThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(planes_to_rgb_backward, PlanesToRgbBackward)

}  // namespace kv::color::cuda
