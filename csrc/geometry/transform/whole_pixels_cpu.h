// Warps that move whole pixels, as flips, crops and padding do, copy on the CPU. Included outside of namespaces.
#pragma once

#include <cstddef>

#include "core/images.h"
#include "geometry/transform/reverse_row.h"
#include "geometry/transform/warp_matrix.h"

namespace kv::geometry::KV_ISA {
namespace {

// Flips and shifts by whole pixels, from pixels of the result to those of the image. All weights are 1 and 0.
KV_HD bool moves_whole_pixels(Homography<double> const& map) {
  auto const is_one = [](double x) { return x == 1 || x == -1; };
  auto const is_integer = [](double x) { return x > -(1 << 30) && x < 1 << 30 && x == double(int64_t(x)); };
  return map.affine && is_one(map.m[0]) && is_one(map.m[4]) && map.m[1] == 0 && map.m[3] == 0 && is_integer(map.m[2]) &&
         is_integer(map.m[5]);
}

// Copies `count` pixels of C channels, 0 for any number, side by side; those of the image in either direction.
template <int C, class T>
void copy_pixels(T const* from, T* to, int64_t count, int64_t channels, bool reversed) {
  int64_t const step = C ? C : channels;
  if (!reversed) {
    __builtin_memcpy(to, from, size_t(count * step) * sizeof(T));
    return;
  }
  if (step == 1) return reverse_row(from + 1 - count, to, count);
  for (int64_t x = 0; x < count; ++x)
    for (int64_t c = 0; c < step; ++c) to[x * step + c] = from[c - x * step];
}

// Pixels `step` elements apart: of one channel, or of several that are side by side in both.
template <class T>
void copy_pixels(T const* from, int64_t from_step, T* to, int64_t step, int64_t count, int64_t channels,
                 bool reversed) {
  if (from_step == channels && step == channels)
    return channels == 1   ? copy_pixels<1>(from, to, count, channels, reversed)
           : channels == 3 ? copy_pixels<3>(from, to, count, channels, reversed)
                           : copy_pixels<0>(from, to, count, channels, reversed);
  for (int64_t n = 0; n < count; ++n) to[n * step] = from[(reversed ? -n : n) * from_step];
}

// One channel of images as images.
template <class T>
KV_HD Images<T> channel_of(Images<T> images, int c) {
  images.data = images.row(0, c, 0);
  images.channels = 1;
  return images;
}

// Rows [begin, end) of sample b, whose map to image i moves whole pixels. Planes are written one after the other.
// `outside(plane, c, y, first, count)` sets pixels that are not in the image, of channel c, or of all from c on.
template <class T, class Outside>
void copy_rows(Images<T const> const& image, int64_t i, Images<T> const& result, int64_t b,
               Homography<double> const& map, int64_t begin, int64_t end, Outside outside) {
  bool const reversed = map.m[0] < 0;
  int64_t const u = int64_t(map.m[2]), width = result.width;
  int64_t const before = reversed ? u - image.width + 1 : -u, after = reversed ? u + 1 : image.width - u;
  int64_t const first = clamp(before, int64_t(0), width), last = clamp(after, first, width);
  int const channels = image.channels;
  bool const is_dense =
      image.channel_stride == 1 && result.channel_stride == 1 && image.step == channels && result.step == channels;
  for (int c = 0; c < (is_dense ? 1 : channels); ++c) {
    Images<T const> const from = is_dense ? image : channel_of(image, c);
    Images<T> const to = is_dense ? result : channel_of(result, c);
    for (int64_t y = begin; y < end; ++y) {
      int64_t const v = int64_t(map.m[4]) * y + int64_t(map.m[5]);
      bool const inside = v >= 0 && v < image.height && first < last;
      if (inside)
        copy_pixels(from.row(i, 0, v) + (reversed ? u - first : u + first) * from.step, from.step,
                    to.row(b, 0, y) + first * to.step, to.step, last - first, to.channels, reversed);
      int64_t const left = inside ? first : 0, right = inside ? last : 0;
      if (left > 0) outside(to, c, y, int64_t(0), left);
      if (right < width) outside(to, c, y, right, width - right);
    }
  }
}

// Sets a part of a row to value(channel).
template <class T, class Value>
void fill_pixels(Images<T> const& result, int64_t b, int64_t y, int64_t first, int64_t count, Value value) {
  for (int c = 0; c < result.channels; ++c) {
    T* const to = result.row(b, c, y) + first * result.step;
    Compute<T> const of_channel = value(c);
    if (result.step == 1)
      for_each_vector<T>(0, count, [&](auto lanes, int64_t x) {
        constexpr int N = decltype(lanes)::value;
        store<N>(to + x, Lanes<Compute<T>, N>{} + of_channel);
      });
    else
      for (int64_t x = 0; x < count; ++x) store<1>(to + x * result.step, of_channel);
  }
}

}  // namespace
}  // namespace kv::geometry::KV_ISA
