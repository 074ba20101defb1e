// What a GPU record was measured from: the project's sources that a task's results depend on, and a digest of
// each that comments and white space do not change.
#pragma once

#include <set>
#include <string>
#include <vector>

#include "core/results.hpp"

namespace gpuphys {

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
/// includer and line when an include does not exist below `source_root`.
std::set<std::string> source_dependencies(const std::string& source_root,
                                          const std::vector<std::string>& roots);

/// Digest of each dependency: C++ and CUDA sources by stripped_source(), everything else (patches) by its
/// bytes.
SourceDigest digest_sources(const std::string& source_root, const std::vector<std::string>& roots);

/// The sources that a task's record starts from: case, reference, serial baseline, mutant patches, the fmad
/// variant's declaration, and the code that runs, judges and times modules.
std::vector<std::string> record_roots(const std::string& source_root, const std::string& family,
                                      const std::string& task);

/// One line a difference: "changed: core/x.cpp", "added: ...", "removed: ...". Empty when both are the same.
std::vector<std::string> digest_differences(const SourceDigest& recorded, const SourceDigest& now);

}  // namespace gpuphys
