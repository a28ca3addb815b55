// Kernels without torch, as an emulator of another processor runs them too: a stencil and window sums in every storage
// type against the formula in double, and their backward against the differences of the forward.
#include <cmath>
#include <vector>

#include "check.h"
#include "core/dtype.h"
#include "filters/edges/sobel.h"
#include "filters/smoothing/box.h"

#define KV_EACH_TYPE(f) f(float, 1e-5) f(double, 1e-12) f(kv::Half, 2e-3) f(kv::BFloat16, 2e-2)

namespace {

double value(float x) { return x; }
double value(double x) { return x; }
double value(kv::Half x) { return kv::to_float(x); }
double value(kv::BFloat16 x) { return kv::to_float(x); }
void set(float& x, double v) { x = float(v); }
void set(double& x, double v) { x = v; }
void set(kv::Half& x, double v) { x = kv::to_half(float(v)); }
void set(kv::BFloat16& x, double v) { x = kv::to_bfloat16(float(v)); }

// Two planes of numbers in [0, 1).
template <class T>
struct Images {
  int64_t height, width;
  std::vector<T> values;

  Images(int64_t h, int64_t w, uint32_t seed) : height(h), width(w), values(2 * h * w) {
    for (T& x : values) set(x, double((seed = seed * 1664525u + 1013904223u) >> 8) / (1 << 24));
  }
  kv::Planes<T> planes() { return {values.data(), 1, 2, 0, height * width, width, height, width, 1}; }
  kv::Planes<T const> constant() const { return {values.data(), 1, 2, 0, height * width, width, height, width, 1}; }
  // With the replicate border.
  double at(int64_t plane, int64_t y, int64_t x) const {
    y = std::min(std::max(y, int64_t(0)), height - 1);
    x = std::min(std::max(x, int64_t(0)), width - 1);
    return value(values[(plane * height + y) * width + x]);
  }
};

template <class F>
void for_each_pixel(int64_t height, int64_t width, F f) {
  for (int64_t plane = 0; plane < 2; ++plane)
    for (int64_t y = 0; y < height; ++y)
      for (int64_t x = 0; x < width; ++x) f(plane, y, x);
}

template <class T>
double dot(Images<T> const& a, Images<T> const& b) {
  double sum = 0;
  for (size_t i = 0; i < a.values.size(); ++i) sum += value(a.values[i]) * value(b.values[i]);
  return sum;
}

template <class T>
void test_sobel(int64_t height, int64_t width, double tolerance) {
  Images<T> const x(height, width, 1);
  Images<T> y(height, width, 2);
  kv::filters::KV_ISA::sobel<T>({x.constant(), y.planes(), 1, kv::Compute<T>(1e-6)}, 0, 2 * height);
  for_each_pixel(height, width, [&](int64_t p, int64_t r, int64_t c) {
    double gx = 0, gy = 0;
    for (int i = -1; i <= 1; ++i) {
      gx += (2 - i * i) * (x.at(p, r + i, c + 1) - x.at(p, r + i, c - 1));
      gy += (2 - i * i) * (x.at(p, r + 1, c + i) - x.at(p, r - 1, c + i));
    }
    double const expected = std::sqrt(gx * gx + gy * gy + 1e-6);
    CHECK(std::abs(y.at(p, r, c) - expected) <= tolerance * (1 + expected), height, width, p, r, c, y.at(p, r, c),
          expected);
  });
}

// In double, where differences have the digits for it.
void test_sobel_backward(int64_t height, int64_t width) {
  Images<double> const x(height, width, 1), grad(height, width, 5);
  Images<double> grad_x(height, width, 2);
  kv::filters::KV_ISA::sobel_backward<double>({grad.constant(), x.constant(), grad_x.planes(), 1, 1e-3}, 0, 2 * height);
  auto const loss = [&](Images<double> const& at) {
    Images<double> y(height, width, 2);
    kv::filters::KV_ISA::sobel<double>({at.constant(), y.planes(), 1, 1e-3}, 0, 2 * height);
    return dot(y, grad);
  };
  for (size_t i = 0; i < x.values.size(); ++i) {
    double const step = 1e-5;
    Images<double> up = x, down = x;
    up.values[i] += step;
    down.values[i] -= step;
    double const difference = (loss(up) - loss(down)) / (2 * step);
    CHECK(std::abs(grad_x.values[i] - difference) < 1e-5, height, width, i, grad_x.values[i], difference);
  }
}

template <class T>
void test_box(int64_t height, int64_t width, double tolerance) {
  Images<T> const x(height, width, 3), grad(height, width, 7);
  Images<T> y(height, width, 2), grad_x(height, width, 2);
  kv::filters::Box<T> const box{x.constant(), y.planes(), 3, 5, kv::Border::replicate, 0, 15};
  kv::filters::KV_ISA::box<T>(box, 0, 2 * height);
  for_each_pixel(height, width, [&](int64_t p, int64_t r, int64_t c) {
    double sum = 0;
    for (int i = -1; i <= 1; ++i)
      for (int j = -2; j <= 2; ++j) sum += x.at(p, r + i, c + j);
    CHECK(std::abs(y.at(p, r, c) - sum / 15) <= tolerance, height, width, p, r, c, y.at(p, r, c), sum / 15);
  });
  // The transpose: <box x, grad> = <x, box_backward grad>.
  kv::filters::KV_ISA::box_backward<T>({grad.constant(), grad_x.planes(), 3, 5, kv::Border::replicate, 0, 15}, 0,
                                       2 * height);
  double const left = dot(y, grad), right = dot(x, grad_x);
  CHECK(std::abs(left - right) <= tolerance * left, height, width, left, right);
}

}  // namespace

int main() {
  for (int64_t height : {1, 2, 7})
    for (int64_t width : {1, 3, 4, 5, 16, 37}) {
#define KV_TEST(T, tolerance)              \
  test_sobel<T>(height, width, tolerance); \
  test_box<T>(height, width, tolerance);
      KV_EACH_TYPE(KV_TEST)
      test_sobel_backward(height, width);
    }
  return failures() > 0;
}
