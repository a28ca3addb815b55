// The index rule against literal sequences, and against its transpose: both must have the same pairs.
#include "core/border.h"

#include <algorithm>
#include <cstring>
#include <utility>
#include <vector>

#include "check.h"

using kv::Border;

namespace {

void rule_as_drawn() {
  struct {
    Border border;
    char const* expected;  // positions -2 to 5 of the axis "abcd"; 0 is the constant
  } const cases[] = {{Border::constant, "00abcd00"},
                     {Border::reflect, "cbabcdcb"},
                     {Border::replicate, "aaabcddd"},
                     {Border::circular, "cdabcdab"}};
  for (auto const& [border, expected] : cases)
    for (int i = -2; i < 6; ++i) {
      int const pixel = kv::border_index(border, i, 4);
      CHECK((pixel < 0 ? '0' : "abcd"[pixel]) == expected[i + 2], int(border), i, pixel);
    }
}

void far_positions_stay_in_bounds() {
  for (Border border : {Border::reflect, Border::replicate, Border::circular})
    for (int64_t n : {1, 2, 1000})
      for (int64_t i : {-10'000'000'000L, -10'000'000L, 10'000'000L, 10'000'000'000L}) {
        int64_t const pixel = kv::border_index(border, i, n);
        CHECK(0 <= pixel && pixel < n, int(border), i, n, pixel);
      }
  CHECK(kv::border_index(Border::replicate, int64_t(-10'000'000'000), int64_t(7)) == 0);
  CHECK(kv::border_index(Border::replicate, int64_t(10'000'000'000), int64_t(7)) == 6);
  CHECK(kv::border_index(Border::constant, int64_t(10'000'000'000), int64_t(7)) == -1);
}

template <class Int>
void transpose_has_the_same_pairs() {
  for (Border border : {Border::constant, Border::reflect, Border::replicate, Border::circular})
    for (Int n = 1; n <= 9; ++n) {
      Int const limit = border == Border::reflect ? n - 1 : border == Border::circular ? n : 2 * n;
      for (Int before = 0; before <= limit; ++before)
        for (Int after = 0; after <= limit; ++after) {
          std::vector<std::pair<Int, Int>> read, gathered;  // (pixel, position)
          for (Int i = -before; i < n + after; ++i)
            if (Int const pixel = kv::border_index(border, i, n); pixel >= 0) read.push_back({pixel, i});
          for (Int j = 0; j < n; ++j) {
            size_t const first = gathered.size();
            kv::for_each_reader(border, j, n, before, after, [&](Int i) { gathered.push_back({j, i}); });
            CHECK(gathered[first].second == j, int(border), j, n);  // itself first
          }
          std::sort(read.begin(), read.end());
          std::sort(gathered.begin(), gathered.end());
          CHECK(read == gathered, int(border), n, before, after);
        }
    }
}

}  // namespace

int main() {
  rule_as_drawn();
  far_positions_stay_in_bounds();
  transpose_has_the_same_pairs<int>();
  transpose_has_the_same_pairs<int64_t>();
  return failures();
}
