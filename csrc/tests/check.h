// CHECK(condition, values...): counts a failure and prints where it was and the values; a test's main returns
// failures().
#pragma once

#include <iostream>

inline int& failures() {
  static int count = 0;
  return count;
}

#define CHECK(condition, ...)                                                   \
  do {                                                                          \
    if (!(condition) && ++failures() <= 20) {                                   \
      std::cerr << __FILE__ << ":" << __LINE__ << ": " #condition " with";      \
      [](auto... values) { ((std::cerr << " " << values), ...); }(__VA_ARGS__); \
      std::cerr << "\n";                                                        \
    }                                                                           \
  } while (0)
