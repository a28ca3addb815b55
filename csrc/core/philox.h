// The counter-based generator Philox 4x32-10 (Salmon et al., Parallel Random Numbers: As Easy as 1, 2, 3, SC 2011).
#pragma once

#include "hd.h"

namespace kv {

struct PhiloxWords {
  uint32_t w[4];
};

// Four words from a key and a counter: a bijection of counters for every key.
KV_HD PhiloxWords philox(uint64_t key, uint32_t a, uint32_t b, uint32_t c, uint32_t d) {
  uint32_t low = uint32_t(key), high = uint32_t(key >> 32);
#pragma unroll
  for (int round = 0; round < 10; ++round) {
    uint64_t const first = uint64_t(a) * 0xD2511F53u, second = uint64_t(c) * 0xCD9E8D57u;
    a = uint32_t(second >> 32) ^ b ^ low;
    c = uint32_t(first >> 32) ^ d ^ high;
    b = uint32_t(second);
    d = uint32_t(first);
    low += 0x9E3779B9u;
    high += 0xBB67AE85u;
  }
  return {{a, b, c, d}};
}

// The number in [0, 1) of a word; exact.
KV_HD double unit(uint32_t word) { return word * 0x1p-32; }

// An integer below `count` <= 2^32: the upper word of its product with a word.
KV_HD uint32_t up_to(uint32_t word, uint64_t count) { return uint32_t(word * count >> 32); }

}  // namespace kv
