// Antialiased resizing of windows on the CPU, by the kernel that resizes images: a sample at a time, whose planes share
// their weights. Forward, rows [begin, end) of all results; backward, planes [begin, end) of all images.
#include "geometry/transform/resize/resize_windows.h"

namespace kv::geometry::KV_ISA {
namespace {

// The part of adjacent planes that begins at `first`, with its rows in reverse order if `flipped`.
template <class T>
KV_HD Planes<T> part_of(Planes<T> const& all, int64_t plane, int64_t count, int64_t y, int64_t x, int64_t height,
                        int64_t width, bool flipped) {
  int64_t const between = count > 1 ? all.plane(plane + 1) - all.plane(plane) : 0;
  T* const first = all.row(plane, flipped ? y + height - 1 : y) + x * all.step;
  return {first, count, 1, between, 0, flipped ? -all.row_stride : all.row_stride, height, width, all.step};
}

template <class T>
KV_HD void mirror_row(T* row, int64_t width, int64_t step) {
  for (int64_t i = 0, j = width - 1; i < j; ++i, --j)
    for (int64_t c = 0; c < step; ++c) {
      T const pixel = row[i * step + c];
      row[i * step + c] = row[j * step + c];
      row[j * step + c] = pixel;
    }
}

template <class T>
KV_HD void mirror_rows(Planes<T> const& images, int64_t begin, int64_t end) {
  for (int64_t r = begin; r < end; ++r)
    mirror_row(images.row(r / images.height, r % images.height), images.width, images.step);
}

}  // namespace

template <class T>
void resize_windows(ResizeWindows<T> const& p, int64_t begin, int64_t end) {
  // Rows or planes of a sample. A mirrored window is resized by the same weights in reverse order.
  int64_t const per_sample = p.planes * (p.backward ? 1 : p.y.height);
  for (int64_t at = begin; at < end;) {
    int64_t const b = at / per_sample, next = min(end, (b + 1) * per_sample);
    Window const across = p.window(b, 0), down = p.window(b, 1);
    ResizeAxis const rows = p.resize_axis(down, 1), columns = p.resize_axis(across, 0);
    if (!p.backward) {
      int64_t const first = b * p.planes;
      Resize<T> const q{
          part_of(p.x, p.image_of(b) * p.planes, p.planes, down.first, across.first, down.size, across.size, false),
          part_of(p.y, first, p.planes, 0, 0, p.y.height, p.y.width, down.mirrored), rows, columns};
      KV_ISA::resize(q, at - b * per_sample, next - b * per_sample);
      if (across.mirrored) mirror_rows(q.y, at - b * per_sample, next - b * per_sample);
    } else {
      int64_t const count = next - at, size = p.y.row_size();
      Resize<T> const q{part_of(p.x, at, count, 0, 0, p.x.height, p.x.width, false),
                        part_of(p.y, at, count, down.first, across.first, down.size, across.size, down.mirrored), rows,
                        columns};
      for (int64_t r = at * p.y.height; r < next * p.y.height; ++r) {
        T* const row = p.y.row(r / p.y.height, r % p.y.height);
        for (int64_t e = 0; e < size; ++e) row[e] = T{};
      }
      KV_ISA::resize(q, 0, count * down.size);
      if (across.mirrored) mirror_rows(q.y, 0, count * down.size);
    }
    at = next;
  }
}

KV_INSTANTIATE_WITH_BYTES(resize_windows, ResizeWindows)

}  // namespace kv::geometry::KV_ISA
