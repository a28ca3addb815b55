// RGB to the codes of video frames on the CPU: a row of chroma at a time, with its rows of luma. Compiled once per
// instruction set.
#include "core/lanes.h"
#include "core/scratch.h"
#include "frames_coded.h"

namespace kv::color::KV_ISA {
namespace {

// Numbers to codes of S, the elements of a row `step` apart.
template <class S, class F>
KV_HD void store_codes(F const* from, int64_t count, S* to, int64_t step) {
  if constexpr (__is_same(S, uint16_t)) {
    for (int64_t i = 0; i < count; ++i) to[i * step] = ten_bits(from[i]);
  } else if constexpr (__is_same(F, Compute<S>)) {
    if (step == 1)
      for_each_vector<S>(0, count, [&](auto n, int64_t i) KV_INLINE {
        constexpr int N = decltype(n)::value;
        store<N>(to + i, load<N>(from + i));
      });
    else
      for (int64_t i = 0; i < count; ++i) store<1>(to + i * step, from[i]);
  } else {  // bytes of doubles
    for (int64_t i = 0; i < count; ++i) store<1>(to + i * step, float(from[i]));
  }
}

template <class S, class T>
KV_HD void code_rows(CodedFrames<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const width = p.rgb.width, height = p.rgb.height, chroma_height = p.y.chroma_size;
  int const count = p.x.chroma_size, rows = p.rows_of_chroma();
  Scratch<F> scratch(3 * width);
  F *const luma = scratch.data, *const sums[] = {luma + width, luma + 2 * width};
  for (int64_t i = begin; i < end; ++i) {
    int64_t const frame = i / chroma_height, c = i % chroma_height;
    bool is_first = true;
    for (int at = -1; at < 2; ++at) {
      F const weight = subsampling_weight<F>(p.y, at);
      int64_t const row = clamp(c * rows + at, int64_t(0), height - 1);
      bool const is_own = at >= 0 && at < rows && c * rows + at < height;
      if (weight == F(0) && !is_own) continue;
      T const* colors[3];
      for (int k = 0; k < 3; ++k) colors[k] = p.rgb.row(3 * frame + k, row);
      // No vectors that overlap: later rows add to the sums.
      auto const pixels = [&](auto n, int64_t x) KV_INLINE {
        constexpr int N = decltype(n)::value;
        Lanes<F, N> const r = load<N>(colors[0] + x), g = load<N>(colors[1] + x), b = load<N>(colors[2] + x);
        if (is_own) store<N>(luma + x, p.code(0, r, g, b));
        if (weight != F(0))
          for (int k = 0; k < 2; ++k) {
            Lanes<F, N> const value = p.code(1 + k, r, g, b) * weight;
            store<N>(sums[k] + x, is_first ? value : Lanes<F, N>(load<N>(sums[k] + x) + value));
          }
      };
      int64_t x = 0;
      for (; x + kLanes<T> <= width; x += kLanes<T>) pixels(Width<kLanes<T>>{}, x);
      for (; x < width; ++x) pixels(Width<1>{}, x);
      if (is_own) store_codes(luma, width, p.planes[0].template row<S>(frame, row), p.planes[0].column_stride);
      is_first = is_first && weight == F(0);
    }
    for (int k = 0; k < 2; ++k) {
      F* const row = sums[k];
      if (p.x.is_halved()) {
        F before = row[0];
        for (int64_t x = 0; x < count; ++x) {
          F const here = row[2 * x], after = row[min(2 * x + 1, width - 1)];
          row[x] = p.x.site == ChromaSite::nearest   ? here
                   : p.x.site == ChromaSite::between ? (here + after) * F(0.5)
                                                     : here * F(0.5) + (before + after) * F(0.25);
          before = after;
        }
      }
      store_codes(row, count, p.planes[1 + k].template row<S>(frame, c), p.planes[1 + k].column_stride);
    }
  }
}

}  // namespace

template <class T>
void coded_frames(CodedFrames<T> const& p, int64_t begin, int64_t end) {
  if (p.code_bytes == 1) return code_rows<uint8_t>(p, begin, end);
  if (p.code_bytes == 2) return code_rows<uint16_t>(p, begin, end);
  if constexpr (!__is_same(T, uint8_t)) code_rows<T>(p, begin, end);
}

KV_INSTANTIATE_WITH_BYTES(coded_frames, CodedFrames)

}  // namespace kv::color::KV_ISA
