// gpuphys-stamp: writes beside a module what it was built from. Called by the build after a module is linked.
//
//     gpuphys-stamp --root ROOT [--overlay FOLDER] --source FILE --flags TEXT --compiler TEXT --module
//     FILE.so
#include <cstdio>
#include <map>
#include <nlohmann/json.hpp>
#include <string>

#include "core/base/error.hpp"
#include "core/base/files.hpp"
#include "core/base/sha256.hpp"
#include "core/records/source_digest.hpp"

int main(int argc, char** argv) {
  using namespace gpuphys;
  std::map<std::string, std::string> options;
  for (int i = 1; i + 1 < argc; i += 2) options[argv[i]] = argv[i + 1];
  try {
    const std::string module = options["--module"];
    const SourceDigest digest =
        digest_sources({options["--root"], options["--overlay"], true}, {options["--source"]});
    const nlohmann::json stamp = {{"sources", digest.total},
                                  {"flags", options["--flags"]},
                                  {"compiler", options["--compiler"]},
                                  {"sha256", sha256_hex(read_file(module))}};
    write_file(module.substr(0, module.rfind('.')) + ".stamp.json", stamp.dump() + "\n");
  } catch (const std::exception& e) {
    std::fprintf(stderr, "gpuphys-stamp: %s\n", e.what());
    return static_cast<int>(ExitCode::bad_input);
  }
  return 0;
}
