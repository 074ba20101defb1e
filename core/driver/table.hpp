// Tables for people (aligned plain text) and for programs (CSV).
#pragma once

#include <string>
#include <vector>

namespace gpuphys {

class Table {
 public:
  /// A column title that starts with '>' is aligned to the right (the '>' is not shown).
  explicit Table(std::vector<std::string> titles);
  void add(std::vector<std::string> cells);
  bool empty() const { return rows_.empty(); }

  std::string text() const;
  std::string csv() const;

 private:
  std::vector<std::string> titles_;
  std::vector<bool> right_;
  std::vector<std::vector<std::string>> rows_;
};

/// A number in three significant digits, "-" for NaN, "inf" for infinity.
std::string short_number(double);
/// Every digit, so that a program reads back the same number; empty for NaN.
std::string exact_number(double);

}  // namespace gpuphys
