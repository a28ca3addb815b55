// Matrices of chains of transforms on the CPU: samples [begin, end), four at a time. Compiled once per instruction set.
#include "core/lanes.h"
// Included after core/lanes.h, whose vectors it uses.
#include "augmentation/transforms.h"

namespace kv::augmentation::KV_ISA {
namespace {

// Up to four samples from `begin` on. Past the end the last sample is read again, and nothing is written.
template <class T>
struct FourSamples {
  TransformMatrix<T> const& p;
  int64_t begin;
  int count;

  static KV_HD double number(T x) { return load<1>(&x); }
  KV_HD Double4 read(T const* data, int64_t stride) const {
    int64_t at[4];
    for (int lane = 0; lane < 4; ++lane) at[lane] = (begin + (lane < count ? lane : count - 1)) * stride;
    return Double4{number(data[at[0]]), number(data[at[1]]), number(data[at[2]]), number(data[at[3]])};
  }
  KV_HD void write(T* data, int64_t stride, Double4 x) const {
    for (int lane = 0; lane < count; ++lane) store<1>(data + (begin + lane) * stride, Compute<T>(x[lane]));
  }
  KV_HD Double4 input(int column, double number) const {
    return column < 0 ? number + Double4{} : read(p.parameters + column * p.column_stride, p.stride);
  }
};

}  // namespace

template <class T>
void transform_matrix(TransformMatrix<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; b += 4) {
    FourSamples<T> const samples{p, b, int(min(end - b, int64_t(4)))};
    Double4 m[9];
    evaluate_chain(p, m, [&](int column, double number) KV_INLINE { return samples.input(column, number); });
    for (int i = 0; i < 9; ++i) samples.write(p.result + i, 9, m[i]);
  }
}

template <class T>
void transform_matrix_backward(TransformMatrix<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; b += 4) {
    FourSamples<T> const samples{p, b, int(min(end - b, int64_t(4)))};
    for (int seeded = 0; seeded < p.columns; ++seeded) {
      Dual<Double4, 1> m[9];
      evaluate_chain(p, m, [&](int column, double number) KV_INLINE {
        return Dual<Double4, 1>{samples.input(column, number), {double(column == seeded) + Double4{}}};
      });
      Double4 sum{};
      for (int i = 0; i < 9; ++i) sum += samples.read(p.grad + i, 9) * m[i].d[0];
      samples.write(p.grad_parameters + seeded, p.columns, sum);
    }
  }
}

KV_INSTANTIATE(transform_matrix, TransformMatrix)
KV_INSTANTIATE(transform_matrix_backward, TransformMatrix)

}  // namespace kv::augmentation::KV_ISA
