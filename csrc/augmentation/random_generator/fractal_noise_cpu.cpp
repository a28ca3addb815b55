// Fractal noise on the CPU: all levels of planes [begin, end). Compiled once per instruction set.
#include "augmentation/random_generator/fractal_noise.h"
#include "core/lanes.h"
#include "core/scratch.h"

namespace kv::augmentation::KV_ISA {

template <class T>
void fractal_noise(FractalNoise<T> const& params, int64_t begin, int64_t end) {
  FractalNoise<T> last = params;
  while (!last.is_last()) last.next();
  int64_t const most = last.fine_height() * last.fine_width();
  Scratch<double> memory(2 * most);
  Scratch<uint32_t> words(most + 3);
  for (int64_t plane = begin; plane < end; ++plane) {
    int64_t const b = plane / params.channels, c = plane % params.channels;
    FractalNoise<T> p = params;
    DrawSource const source = p.noise.source(b);
    double *coarse = memory.data, *fine = memory.data + most;
    for (int64_t i = 0; i < p.h * p.w; ++i) coarse[i] = p.corner(source, c, i / p.w, i % p.w);
    for (;;) {
      int64_t const wide = p.fine_width(), numbers = p.fine_height() * wide, w = p.w;
      if (p.level > 0)
        for (int64_t block = 0; block < p.blocks(numbers); ++block) {
          PhiloxWords const four = p.words(source, c, numbers, block);
          for (int k = 0; k < 4; ++k) words.data[4 * block + k] = four.w[k];
        }
      auto const level = contrib::fractal_plane(
          [=](int64_t v, int64_t u) KV_INLINE { return coarse[v * w + u]; },
          [&](int64_t y, int64_t x) KV_INLINE { return p.level > 0 ? p.number_of(words.data[y * wide + x]) : 0.; },
          p.weight(b), p.h, p.w);
      if (p.is_last()) {
        T* const result = p.y + plane * p.tall * p.wide;
        for (int64_t y = 0; y < p.tall; ++y)
          for (int64_t x = 0; x < p.wide; ++x)
            result[y * p.wide + x] = y < p.height && x < p.width ? T(level.at(y, x)) : T(0);
        break;
      }
      for (int64_t i = 0; i < numbers; ++i) fine[i] = level.at(i / wide, i % wide);
      double* const other = coarse;
      coarse = fine, fine = other;
      p.next();
    }
  }
}

template <class T>
void fractal_noise_list(FractalNoiseList<T> const& p, int64_t begin, int64_t end) {
  for (int64_t plane = begin; plane < end; ++plane) {
    int64_t const b = plane / p.all.channels, c = plane - b * p.all.channels;
    KV_ISA::fractal_noise(p.sample(int(b)), c, c + 1);
  }
}

KV_INSTANTIATE_COMPUTED(fractal_noise, FractalNoise)
KV_INSTANTIATE_COMPUTED(fractal_noise_list, FractalNoiseList)

}  // namespace kv::augmentation::KV_ISA
