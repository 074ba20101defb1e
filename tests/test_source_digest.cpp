// The source digest: what changes it, what does not, and that it follows every include.
#include "core/records/source_digest.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <sstream>

#include "core/base/files.hpp"

namespace gpuphys {
namespace {

namespace fs = std::filesystem;

std::string strip(const std::string& text) {
  return stripped_source(text, "test.cpp");
}

#define EXPECT_SAME(a, b) EXPECT_EQ(strip(a), strip(b))
#define EXPECT_DIFFERENT(a, b) EXPECT_NE(strip(a), strip(b))

// A folder that looks like a repository and disappears with the test.
class Tree : public testing::Test {
 protected:
  Tree() {
    std::string pattern = (fs::temp_directory_path() / "gpuphys_digest_XXXXXX").string();
    root = ::mkdtemp(pattern.data());
  }
  ~Tree() override { fs::remove_all(root); }

  void put(const std::string& path, const std::string& text) const { write_file(root + "/" + path, text); }
  std::string total(const std::vector<std::string>& roots) const {
    return digest_sources({root, "", false}, roots).total;
  }

  std::string root;
};

TEST(StrippedSource, CommentsDoNotCount) {
  EXPECT_SAME("int a = 1;  // one\n", "int a = 1;\n");
  EXPECT_SAME("int /* type */ a = 1;", "int a = 1;");
  EXPECT_SAME("int/**/a;", "int a;");
  EXPECT_SAME("/* a\n * b */\nint a;", "int a;");
  EXPECT_SAME("int a; // continued \\\n still a comment\nint b;", "int a; int b;");
}

TEST(StrippedSource, WhiteSpaceAndLineEndsDoNotCount) {
  EXPECT_SAME("int f(){return a+b;}", "int f ( )\n{\n\treturn a + b ;\r\n}\n");
  EXPECT_SAME("View<View<int>> v;", "View<View<int> > v;");
  EXPECT_SAME("kernel<<<g,b>>>(x);", "kernel <<< g, b >>> (x);");
  EXPECT_SAME("", "\n\n  \n// nothing\n");
}

TEST(StrippedSource, TokensDoCount) {
  EXPECT_DIFFERENT("x = a + b;", "x = a - b;");
  EXPECT_DIFFERENT("int ab;", "int a b;");
  EXPECT_DIFFERENT("x = 1.0f;", "x = 1.0;");
  EXPECT_DIFFERENT("x = a++ + b;", "x = a + ++b;");
  EXPECT_DIFFERENT("x = 1e-5;", "x = 1e - 5;");
}

TEST(StrippedSource, LiteralsKeepTheirContent) {
  EXPECT_DIFFERENT("s = \"a  b\";", "s = \"a b\";");
  EXPECT_DIFFERENT("s = \"a // b\";", "s = \"a\";");
  EXPECT_DIFFERENT("s = \"/* x */\";", "s = \"\";");
  EXPECT_SAME("s = \"\\\"// kept\";  // dropped", "s = \"\\\"// kept\";");
  EXPECT_DIFFERENT("c = '\"'; // x\" ;", "c = '\"'; x");
  EXPECT_SAME("c = '\\''; // x", "c = '\\'';");
  EXPECT_DIFFERENT("s = u8\"x\";", "s = u8 \"x\";");
}

TEST(StrippedSource, DigitSeparatorsStartNoLiteral) {
  EXPECT_SAME("n = 1'000'000; // it's a million", "n = 1'000'000;");
  EXPECT_DIFFERENT("n = 1'000;", "n = 1'001;");
}

TEST(StrippedSource, RawStringsAreTakenAsTheyAre) {
  EXPECT_DIFFERENT("s = R\"(a // b)\";", "s = R\"(a)\";");
  EXPECT_DIFFERENT("s = R\"(a\n\nb)\";", "s = R\"(a\nb)\";");
  EXPECT_DIFFERENT("s = R\"x(a)\" // )x\";", "s = R\"x(a)\" )x\";");
  EXPECT_SAME("s = R\"x(\")\" /* in */)x\"; // out", "s = R\"x(\")\" /* in */)x\";");
  EXPECT_DIFFERENT("s = R\"(a\\\nb)\";", "s = R\"(ab)\";");
}

TEST(StrippedSource, ContinuedLinesAreOneLine) {
  EXPECT_SAME("#define F(x) \\\n  g(x)\n", "#define F(x) g(x)\n");
  EXPECT_SAME("int a\\\nb;", "int ab;");
  EXPECT_SAME("/\\\n/ comment\nint a;", "int a;");
}

TEST(StrippedSource, DirectivesEndWithTheirLine) {
  EXPECT_DIFFERENT("#define A\nint b;", "#define A int b;");
  EXPECT_DIFFERENT("#define f(x) 1\n", "#define f (x) 1\n");
  EXPECT_SAME("#  define   A   1 // one\n", "#define A 1\n");
  EXPECT_SAME("#error don't\nint a;", "#error   don't\n\nint   a ;");
}

TEST(StrippedSource, WhatDoesNotEndIsAnErrorWithItsLine) {
  try {
    strip("int a;\n/* open");
    FAIL() << "accepted";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ExitCode::bad_input);
    EXPECT_STREQ(e.what(), "test.cpp:2: comment does not end");
  }
  EXPECT_THROW(strip("s = R\"x(open)\";"), Error);
}

TEST(QuotedIncludes, AreFoundAndOnlyReal) {
  const std::string text =
      "#include \"core/a.hpp\"\n#include <vector>\n// #include \"core/no.hpp\"\n/*\n#include "
      "\"core/no.hpp\"\n*/\n"
      "  #  include   \"core/b.hpp\"  // why\nconst char* s = R\"(\n#include \"core/no.hpp\"\n)\";\n#if "
      "0\n#include \"core/c.hpp\"\n#endif\n";
  EXPECT_EQ(quoted_includes(text, "t"), (std::vector<std::string>{"core/a.hpp", "core/b.hpp", "core/c.hpp"}));
}

TEST_F(Tree, FollowsIncludesAndImplementations) {
  put("a/main.cpp", "#include \"b/x.hpp\"\n");
  put("b/x.hpp", "#pragma once\n#include \"b/y.hpp\"\n");
  put("b/x.cpp", "#include \"b/x.hpp\"\n#include \"c/z.cuh\"\n");
  put("b/y.hpp", "int y;\n");
  put("c/z.cuh", "int z;\n");
  put("c/z.cu", "int zz;\n");
  put("c/other.hpp", "int o;\n");
  EXPECT_EQ(source_dependencies({root, "", false}, {"a/main.cpp"}),
            (std::set<std::string>{"a/main.cpp", "b/x.hpp", "b/x.cpp", "b/y.hpp", "c/z.cuh", "c/z.cu"}));
}

TEST_F(Tree, DigestSeesAChangeAnywhereBelow) {
  put("main.cpp", "#include \"x.hpp\"\n");
  put("x.hpp", "int x();\n");
  put("x.cpp", "int x() { return 1; }\n");
  const SourceDigest before = digest_sources({root, "", false}, {"main.cpp"});
  put("x.cpp", "int x() {\n  return 1;  // one\n}\n");
  EXPECT_EQ(digest_sources({root, "", false}, {"main.cpp"}).total, before.total);
  EXPECT_TRUE(digest_differences(before, digest_sources({root, "", false}, {"main.cpp"})).empty());
  put("x.cpp", "int x() { return 2; }\n");
  const SourceDigest after = digest_sources({root, "", false}, {"main.cpp"});
  EXPECT_NE(after.total, before.total);
  EXPECT_EQ(digest_differences(before, after), std::vector<std::string>{"changed: x.cpp"});
}

TEST_F(Tree, DifferencesNameAddedAndRemovedFiles) {
  put("main.cpp", "#include \"x.hpp\"\n");
  put("x.hpp", "int x();\n");
  const SourceDigest before = digest_sources({root, "", false}, {"main.cpp"});
  put("main.cpp", "#include \"y.hpp\"\n");
  put("y.hpp", "int x();\n");
  EXPECT_EQ(digest_differences(before, digest_sources({root, "", false}, {"main.cpp"})),
            (std::vector<std::string>{"changed: main.cpp", "added: y.hpp", "removed: x.hpp"}));
}

TEST_F(Tree, OfAModuleOnlyItsOwnSideIsFollowed) {
  put("references/r.cu", "#include \"cases/t.hpp\"\n#include \"references/p.hpp\"\n");
  put("cases/t.hpp", "int t;\n");
  put("cases/t.cpp", "int tolerance;\n");
  put("references/p.hpp", "int p();\n");
  put("references/p.cu", "int p() { return 1; }\n");
  EXPECT_EQ(source_dependencies({root, "", true}, {"references/r.cu"}),
            (std::set<std::string>{"references/r.cu", "cases/t.hpp", "references/p.hpp", "references/p.cu"}));
}

// A mutant's patched copies come first, as on its include path.
TEST_F(Tree, AnOverlayReplacesWhatItHolds) {
  put("main.cpp", "#include \"x.hpp\"\n");
  put("x.hpp", "int x = 1;\n");
  put("patched/x.hpp", "int x = 2;\n");
  const std::string plain = digest_sources({root, "", false}, {"main.cpp"}).total;
  EXPECT_NE(digest_sources({root, root + "/patched", false}, {"main.cpp"}).total, plain);
  put("patched/x.hpp", "int x = 1;  // the same\n");
  EXPECT_EQ(digest_sources({root, root + "/patched", false}, {"main.cpp"}).total, plain);
}

TEST_F(Tree, IncludeCyclesEnd) {
  put("a.hpp", "#pragma once\n#include \"b.hpp\"\n");
  put("b.hpp", "#pragma once\n#include \"a.hpp\"\n");
  EXPECT_EQ(source_dependencies({root, "", false}, {"a.hpp"}).size(), 2u);
}

TEST_F(Tree, AMissingIncludeIsAnErrorThatNamesTheIncluder) {
  put("a.hpp", "#pragma once\n\n#include \"gone.hpp\"\n");
  try {
    total({"a.hpp"});
    FAIL() << "accepted";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ExitCode::bad_input);
    EXPECT_NE(std::string(e.what()).find("a.hpp:3: includes \"gone.hpp\""), std::string::npos) << e.what();
  }
  EXPECT_THROW(total({"gone.cpp"}), Error);
  put("outside.hpp", "#include \"../x.hpp\"\n");
  EXPECT_THROW(total({"outside.hpp"}), Error);
}

TEST_F(Tree, PatchesCountByTheByte) {
  put("m.patch", "what\n+  a\n");
  const std::string before = total({"m.patch"});
  put("m.patch", "what\n+   a\n");
  EXPECT_NE(total({"m.patch"}), before);
}

// The compiler decides what a source depends on; the digest must cover at least that.
TEST(RealSources, CoverTheCompilersDependencyList) {
  const std::string root = GPUPHYS_SOURCE_ROOT;
  const std::string source = GPUPHYS_DEPENDENCY_SOURCE;  // a case file, relative to the root
  const std::string command = "cd '" + root +
                              "' && '" GPUPHYS_CXX_COMPILER "' -std=c++20 -MM -I. " GPUPHYS_CXX_FLAGS " '" +
                              source + "'";
  const std::unique_ptr<FILE, int (*)(FILE*)> pipe(::popen(command.c_str(), "r"), ::pclose);
  ASSERT_NE(pipe, nullptr);
  std::string output;
  std::array<char, 4096> buffer;
  while (const std::size_t n = std::fread(buffer.data(), 1, buffer.size(), pipe.get()))
    output.append(buffer.data(), n);
  std::istringstream words(output);
  const std::set<std::string> ours = source_dependencies({root, "", false}, {source});
  std::size_t compared = 0;
  for (std::string word; words >> word;) {
    if (word == "\\" || word.back() == ':') continue;
    const std::string path = fs::path(word).lexically_normal().generic_string();
    EXPECT_TRUE(ours.contains(path)) << "the compiler reads " << path << ", the digest does not";
    ++compared;
  }
  EXPECT_GE(compared, 5u) << command << "\n" << output;
  for (const std::string& file : ours) EXPECT_NO_THROW(digest_sources({root, "", false}, {file})) << file;
}

}  // namespace
}  // namespace gpuphys
