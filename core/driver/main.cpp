// gpuphys: the command line of the suite.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <new>
#include <system_error>

#include "core/base/text.hpp"
#include "core/base/version.hpp"
#include "core/driver/context.hpp"

namespace gpuphys {

namespace {

int lost_output(const std::string& why) {
  try {
    fmt::print(stderr, "gpuphys: standard output cannot be written: {}\n", why);
  } catch (const std::system_error&) {
  }
  return static_cast<int>(ExitCode::output_lost);
}

int run(int argc, char** argv) {
  CLI::App app{"Regression and tolerance validation for the GPUPhysBench tasks."};
  app.set_version_flag("--version", kSuiteVersion);
  app.require_subcommand(1);
  app.footer("Exit codes:\n" + exit_code_table() +
             "\nExamples:\n"
             "  gpuphys list --task advect_rk2\n"
             "  gpuphys run --task advect_rk2 --module reference\n"
             "  gpuphys run --task advect_rk2 --module ./mine.so --set public --set hidden\n"
             "  gpuphys time --task advect_rk2 --module ./mine.so\n"
             "  gpuphys verdict\n");

  Context ctx;
  const auto from_environment = [](const char* name, const char* fallback) {
    const char* value = std::getenv(name);
    return std::string(value != nullptr ? value : fallback);
  };
  const std::string build = from_environment("GPUPHYS_BUILD_DIR", GPUPHYS_BINARY_DIR);
  ctx.source_root = from_environment("GPUPHYS_SOURCE_DIR", GPUPHYS_SOURCE_DIR);
  ctx.modules_root = build + "/modules";
  ctx.results_root = build + "/results";
  ctx.build_root = build;
  ctx.store_root = build + "/store";
  ctx.runner = from_environment("GPUPHYS_RUNNER", (build + "/gpuphys-runner").c_str());
  app.add_option("--results", ctx.results_root, "Folder of results")->capture_default_str();
  app.add_option("--modules", ctx.modules_root, "Folder of the modules built with the suite")
      ->capture_default_str();
  app.add_option("--store", ctx.store_root, "Folder of made inputs and truths that memory has no room for")
      ->capture_default_str();
  app.fallthrough();

  add_list_command(app, ctx);
  add_run_command(app, ctx);
  add_check_command(app, ctx);
  add_export_command(app, ctx);
  add_tolerance_command(app, ctx);
  add_mutants_command(app, ctx);
  add_time_command(app, ctx);
  add_verdict_command(app, ctx);
  add_report_command(app, ctx);
  add_record_command(app, ctx);
  add_check_records_command(app, ctx);
  add_trivial_command(app, ctx);
  add_ctest_file_command(app, ctx);
  add_prepare_command(app, ctx);
  add_store_command(app, ctx);
  add_modules_command(app, ctx);

  // Relative to where the command was given, whatever changes its folder later.
  app.parse_complete_callback([&ctx] {
    for (std::string* path :
         {&ctx.results_root, &ctx.modules_root, &ctx.store_root, &ctx.runner, &ctx.build_root})
      *path = std::filesystem::absolute(*path).string();
  });

  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : static_cast<int>(ExitCode::usage);
  } catch (const Error& e) {
    fmt::print(stderr, "gpuphys: {}\n", printable(e.what(), 2000));
    if (e.code() == ExitCode::skipped && std::getenv("GPUPHYS_REQUIRE_GPU") != nullptr &&
        !app.got_subcommand("check-records")) {
      fmt::print(stderr, "gpuphys: GPUPHYS_REQUIRE_GPU is set: a missing GPU is a failure\n");
      return static_cast<int>(ExitCode::cuda_error);
    }
    return static_cast<int>(e.code());
  } catch (const std::bad_alloc&) {
    fmt::print(stderr, "gpuphys: out of host memory\n");
    return static_cast<int>(ExitCode::out_of_memory);
  } catch (const std::system_error& e) {  // fmt throws it when a line cannot be written
    return lost_output(e.what());
  } catch (const std::exception& e) {
    fmt::print(stderr, "gpuphys: internal error: {}\n", e.what());
    return static_cast<int>(ExitCode::internal);
  }
  // A verdict that nobody could read is none.
  if (std::fflush(stdout) != 0 || std::ferror(stdout) != 0) return lost_output(std::strerror(errno));
  return static_cast<int>(ctx.exit_code);
}

}  // namespace
}  // namespace gpuphys

int main(int argc, char** argv) {
  return gpuphys::run(argc, argv);
}
