// What something was built from: the project's sources that it depends on, and a digest of each that comments
// and white space do not change.
#pragma once

#include <map>
#include <set>
#include <string>
#include <vector>

namespace gpuphys {

/// Root-relative source -> SHA-256 of its stripped text, and the SHA-256 over all of them.
struct SourceDigest {
  std::map<std::string, std::string> files;
  std::string total;
};

/// Where sources are looked for: first in `overlay` (patched copies of a mutant; may be empty), then in
/// `source`.
struct Roots {
  std::string source, overlay;
  /// Of headers below cases/ and core/ the implementations do not count: a module reads a task's contract,
  /// but does not link its case file.
  bool of_module = false;
};

/// C++ or CUDA source reduced to its tokens: comments removed, tokens joined by single blanks,
/// line continuations spliced. String, character and raw-string literals are kept as they are. Preprocessor
/// directives stay on lines of their own. Throws Error(bad_input) naming `where` and the line for an
/// comment or raw string that does not end.
std::string stripped_source(const std::string& text, const std::string& where);

/// The quoted includes of a source, in order (`#include "..."`; those in comments and literals do not count).
std::vector<std::string> quoted_includes(const std::string& text, const std::string& where);

/// The root-relative paths of `roots` and of everything they include by quotes, recursively. A header stands
/// for its implementation: foo.hpp brings foo.cpp and foo.cu where they exist. Conditional compilation is not
/// evaluated, so the set may be larger than the compiler's, never smaller. Throws Error(bad_input) naming
/// includer and line when an include does not exist.
std::set<std::string> source_dependencies(const Roots&, const std::vector<std::string>& roots);

/// Digest of each dependency: C++ and CUDA sources by stripped_source(), everything else by its bytes.
SourceDigest digest_sources(const Roots&, const std::vector<std::string>& roots);

/// One line a difference: "changed: core/x.cpp", "added: ...", "removed: ...". Empty when both are the same.
std::vector<std::string> digest_differences(const SourceDigest& recorded, const SourceDigest& now);

}  // namespace gpuphys
