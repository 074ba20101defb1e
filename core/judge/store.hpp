// Inputs and truths, made once and mapped by every run after that.
//
// An entry is one raw file: a header, then the arrays, each from a page of its own on, with a digest for
// each. It lies in a memory file system where there is room and on disk otherwise, under a name made of what
// it depends on; a change of that is another file. Both places are bounded: what was not used for longest
// goes first. Entries are checked when they are mapped; one that is not what its digests say is removed, with
// one line on stderr, and made again.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "core/contract/arrays.hpp"

namespace gpuphys {

/// Digest (hex) of names, types, shapes and bytes. Fast, not cryptographic: nobody who could choose the bytes
/// gains anything.
std::string digest_of(const Arrays&);
/// The same over inputs and scalars.
std::string digest_of(const Problem&);

struct Stored {
  Arrays arrays;  ///< read-only
  std::vector<Scalar> scalars;
  std::string digest;  ///< digest_of() what was stored
};

class Store {
 public:
  /// `disk_root`: the folder that holds what memory has no room for. GPUPHYS_STORE_GIB bounds the memory
  /// (default: 40 % of the machine's where that is 64 GiB or more, 15 % below that; 0: disk only).
  explicit Store(std::string disk_root);

  /// The entry `key` of `group` (a folder: the task), made by `make` if it is not there. Processes that want
  /// the same entry at the same time make it once. Where nothing can be written, what was made is returned
  /// without being kept.
  Stored obtain(const std::string& group, const std::string& key, const std::function<Stored()>& make) const;

  /// Removes everything in both places.
  void clear() const;
  /// Bytes kept in memory and on disk.
  std::pair<std::uint64_t, std::uint64_t> size() const;

 private:
  std::optional<Stored> find(const std::string& path) const;
  bool keep(const std::string& root, std::uint64_t budget, const std::string& group, const std::string& key,
            const Stored& made) const;

  std::string memory_root_, disk_root_;
  std::uint64_t memory_budget_ = 0, disk_budget_ = 0;
};

/// The folder of the memory file system that entries go to; runners cannot read it.
std::string memory_store_root();

}  // namespace gpuphys
