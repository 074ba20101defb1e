// Arrays, symbolic shapes, and the errors of inputs that do not fit a contract.
#include <gtest/gtest.h>

#include "core/contract/arrays.hpp"

namespace gpuphys {
namespace {

Contract contract() {
  Contract c;
  c.inputs = {{"u", DType::f32, 2, "nx+1,ny", "m/s"},
              {"mask", DType::boolean, 2, "nx,ny", "1"},
              {"table", DType::i32, 1, "3", "1"}};
  c.outputs = {{"v", DType::f32, 2, "nx,ny+2", "m/s"}};
  c.scalars = {{"dt", DType::f32, "s"}};
  return c;
}

Problem problem(Shape u, Shape mask, Shape table) {
  Problem p;
  p.inputs.emplace_back("u", DType::f32, u);
  p.inputs.emplace_back("mask", DType::boolean, mask);
  p.inputs.emplace_back("table", DType::i32, table);
  p.scalars = {{"dt", DType::f32, 0.1}};
  return p;
}

// The message of the Error that `body` throws, checked for its exit code.
template <class Body>
std::string message_of(ExitCode code, Body&& body) {
  try {
    body();
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), code) << e.what();
    return e.what();
  }
  ADD_FAILURE() << "nothing was thrown";
  return "";
}

TEST(Arrays, SymbolsFollowFromTheShapes) {
  const auto symbols = resolve_symbols(contract(), problem({5, 7}, {4, 7}, {3}), "test");
  EXPECT_EQ(symbols.at("nx"), 4);
  EXPECT_EQ(symbols.at("ny"), 7);
}

TEST(Arrays, OutputsTakeTheirShapeFromTheInputs) {
  const Arrays out = make_outputs(contract(), problem({5, 7}, {4, 7}, {3}), DType::f64);
  ASSERT_EQ(out.size(), 1u);
  EXPECT_EQ(out[0].shape(), (Shape{4, 9}));
  EXPECT_EQ(out[0].dtype(), DType::f64);
}

TEST(Arrays, AContradictionNamesBothArrays) {
  const std::string message = message_of(ExitCode::bad_input, [] {
    resolve_symbols(contract(), problem({5, 7}, {5, 7}, {3}), "f.h5");
  });
  for (const char* part : {"f.h5", "'mask'", "(5, 7)", "nx = 4", "'u'"})
    EXPECT_NE(message.find(part), std::string::npos) << message;
}

TEST(Arrays, AFixedExtentIsChecked) {
  const std::string message = message_of(ExitCode::bad_input, [] {
    resolve_symbols(contract(), problem({5, 7}, {4, 7}, {4}), "f.h5");
  });
  EXPECT_NE(message.find("expected 3"), std::string::npos) << message;
}

TEST(Arrays, WrongRankTypeAndMissingArraysAreNamed) {
  message_of(ExitCode::bad_input, [] { resolve_symbols(contract(), problem({5}, {4, 7}, {3}), "f.h5"); });
  Problem wrong_type = problem({5, 7}, {4, 7}, {3});
  wrong_type.inputs[0] = HostArray("u", DType::f64, {5, 7});
  EXPECT_NE(message_of(ExitCode::bad_input, [&] { resolve_symbols(contract(), wrong_type, "f.h5"); })
                .find("float64"),
            std::string::npos);
  Problem missing = problem({5, 7}, {4, 7}, {3});
  missing.inputs.pop_back();
  EXPECT_NE(message_of(ExitCode::bad_input, [&] { resolve_symbols(contract(), missing, "f.h5"); })
                .find("'table' is missing"),
            std::string::npos);
}

TEST(Arrays, AnEmptyAxisIsRefused) {
  message_of(ExitCode::bad_input, [] { resolve_symbols(contract(), problem({1, 7}, {0, 7}, {3}), "f.h5"); });
}

// Particles on a grid: no input array has the extents of the output.
Contract contract_with_shape_scalar() {
  Contract c;
  c.inputs = {{"x", DType::f32, 2, "n,3", "m"}};
  c.outputs = {{"u", DType::f32, 2, "nx,n+1", "m/s"}};
  c.scalars = {{"nx", DType::i32, "1"}, {"count", DType::i32, "1"}, {"dx", DType::f32, "m"}};
  return c;
}

TEST(Arrays, AnInt32ScalarNamedLikeASymbolDefinesIt) {
  const Contract c = contract_with_shape_scalar();
  Problem p = make_problem(c, {{"n", 4}, {"nx", 6}});
  EXPECT_EQ(p.scalar("nx"), 6);
  EXPECT_EQ(p.scalar("count"), 0);  // no extent is stated in terms of it
  EXPECT_EQ(make_outputs(c, p)[0].shape(), (Shape{6, 5}));
  p.set_scalar("nx", 9);
  EXPECT_EQ(make_outputs(c, p)[0].shape(), (Shape{9, 5}));
}

TEST(Arrays, AShapeScalarBelowOneOrNotWholeIsRefused) {
  const Contract c = contract_with_shape_scalar();
  Problem p = make_problem(c, {{"n", 4}, {"nx", 6}});
  for (const double bad : {0.0, -1.0, 2.5, 3e9}) {
    p.set_scalar("nx", bad);
    EXPECT_NE(
        message_of(ExitCode::bad_input, [&] { resolve_symbols(c, p, "f.h5"); }).find("f.h5: scalar 'nx'"),
        std::string::npos);
  }
}

TEST(Arrays, AShapeScalarThatContradictsAnArrayIsNamed) {
  Contract c = contract_with_shape_scalar();
  c.inputs.push_back({"w", DType::f32, 1, "nx", "1"});
  Problem p = make_problem(c, {{"n", 4}, {"nx", 6}});
  p.set_scalar("nx", 7);
  const std::string message = message_of(ExitCode::bad_input, [&] { resolve_symbols(c, p, "f.h5"); });
  for (const char* part : {"'w'", "(6)", "nx = 7", "scalar 'nx'"})
    EXPECT_NE(message.find(part), std::string::npos) << message;
}

TEST(Arrays, ScalarsAreRoundedToTheirType) {
  Problem p = make_problem(contract(), {{"nx", 2}, {"ny", 2}});
  p.set_scalar("dt", 0.1);
  EXPECT_EQ(p.scalar("dt"), static_cast<double>(0.1f));
  message_of(ExitCode::unknown_name, [&] { p.set_scalar("dx", 1); });
}

TEST(Arrays, TypedAccessIsChecked) {
  HostArray a("a", DType::f32, {2});
  message_of(ExitCode::internal, [&] { a.as<double>(); });
}

}  // namespace
}  // namespace gpuphys
