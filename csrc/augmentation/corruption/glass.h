// Pixels that read random neighbors: each moves to one near it, which moves to one near it, and so on, and takes the
// value there. corruption/glass.py of kvision.augmentation defines it.
#pragma once

#include "augmentation/corruption/place_sample.h"
#include "augmentation/noise.h"

namespace kv::augmentation {

// Words give a pixel of each step its moves: the upper half down, the lower half to the right. `uniform`, in place of
// them, has two planes a step.
template <class T>
struct ReadNeighbors {
  PixelNoise<T> noise;  // its images are not used
  T const* x;
  T* y;
  int64_t batch, channels, height, width;
  int64_t x_strides[4], y_strides[4];  // of sample, channel, row and pixel
  int max_delta, steps;                // each from -max_delta to max_delta - 1

  static constexpr int kMaxDelta = 1 << 15;

  struct Pixel {
    int row, column;
  };
  // The words of the block that a pixel is in, in a step.
  KV_HD PhiloxWords words(DrawSource const& source, int step, int pixel) const {
    return source.words(noise.draw, uint32_t(step * noise.blocks()) + uint32_t(pixel / 4));
  }
  KV_HD Pixel moved_by(Pixel at, uint32_t word) const {
    word ^= 0x80000000u;
    uint32_t const range = uint32_t(2 * max_delta);  // at most 2^16, so that products fit
    return moved(at, int((word >> 16) * range >> 16), int((word & 0xFFFF) * range >> 16));
  }
  // Where pixel (row, column) of a sample is after a step.
  KV_HD Pixel step_from(int64_t b, DrawSource const& source, int step, Pixel at) const {
    int const i = at.row * int(width) + at.column;
    if (!noise.uniform) return moved_by(at, words(source, step, i).w[i % 4]);
    int64_t const pixels = height * width;
    float const* const u = noise.numbers(b) + 2 * step * pixels + i;
    float const range = float(2 * max_delta);
    return moved(at, int(u[0] * range), int(u[pixels] * range));
  }
  KV_HD Pixel moved(Pixel at, int down, int right) const {
    return {clamp(at.row + down - max_delta, 0, int(height) - 1),
            clamp(at.column + right - max_delta, 0, int(width) - 1)};
  }
};

KV_KERNEL(read_neighbors, ReadNeighbors)

// Of lists: `all` is what the samples have in common. Samples that are not chosen, by the
// noise, are copied.
template <class T>
struct ReadNeighborsList {
  ReadNeighbors<T> all;
  ListedSamples list;

  KV_HD ReadNeighbors<T> sample(int b) const {
    ReadNeighbors<T> one = all;
    auto const y = place_sample(one, list, b);
    one.noise.skip(b);
    one.noise.skip_numbers(list.images, b);
    one.noise.pixels = y.height * y.width;
    if (!all.noise.is_chosen(b)) one.steps = 0;
    return one;
  }
};

KV_KERNEL(read_neighbors_list, ReadNeighborsList)

// Gradients of pixels are added to those of the pixels that these read. Images are the gradients of results; results
// are sums in the type that is computed in, on CUDA zeros before. On the CPU an item is an image.
template <class T>
struct ReadNeighborsBackwardList : ReadNeighborsList<T> {
  KV_HD Compute<T>* sums(int b) const { return static_cast<Compute<T>*>(this->list.results[b].data); }
};

KV_KERNEL(read_neighbors_list_backward, ReadNeighborsBackwardList)

}  // namespace kv::augmentation
