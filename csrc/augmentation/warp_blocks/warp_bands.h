// Warps with a program of color steps on the CPU: parts [begin, end) of all samples, which are bands of rows. The warp
// writes a band to a buffer that stays in the cache, and the program reads it there.
#pragma once

#include "augmentation/warp_and_color.h"
#include "core/lanes.h"
#include "core/scratch.h"

namespace kv::augmentation::KV_ISA {
namespace {

// warp_of(b) is the warp of sample b.
template <class T, class WarpOf>
void warp_bands(WarpAndColor<T> const& p, int64_t begin, int64_t end, WarpOf warp_of) {
  Images<T> const& y = p.warp.y;
  int64_t const width = y.width, rows = rows_of_band(width), bands = bands_of(y.height, width);
  Scratch<T> band(y.channels * rows * width);
  for (int64_t part = begin; part < end; ++part) {
    int64_t const b = part / bands, first = (part - b * bands) * rows, count = min(rows, y.height - first);
    geometry::Sample<T> warp = warp_of(b);
    warp.y = {band.data - first * width, 0, rows * width, width, 1, y.batch, y.height, width, y.channels};
    geometry::KV_ISA::sample(warp, b * y.height + first, b * y.height + first + count);

    // The band as a sample of its own.
    color::Program<float> program = p.program;
    program.x = {band.data, kDType<T>, y.channels, 1, 0, 0, rows * width, 1};
    program.pixels = count * width;
    program.y.data = static_cast<char*>(program.y.data) + first * width * program.y.step * size_of(program.y.type);
    int64_t const chunks = color::chunks_of<float>(program.pixels);
    color::KV_ISA::program(program, b * chunks, (b + 1) * chunks);
  }
}

}  // namespace
}  // namespace kv::augmentation::KV_ISA
