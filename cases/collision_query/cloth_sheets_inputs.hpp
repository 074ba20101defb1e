// Inputs of the continuous collision tasks: stacked cloth sheets driven into each other, in random order.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <vector>

namespace gpuphys::cloth_sheets {

/// Four sheets of n x n vertices with spacing 1 m (the paper's collision inputs, sizes apart).
struct Parameters {
  std::int64_t n = 0;
  std::uint64_t seed = 1;
  double offset = 1.0;         ///< distance of neighbouring sheets along z, m
  double waviness = 0.3;       ///< amplitude of the standing wave along z, m
  int wave_a = 3, wave_b = 2;  ///< its periods along the two directions of the sheet
  double phase_step = 0.7;     ///< its phase from sheet to sheet, rad
  double drive_period = 40;    ///< period of the motion along z, in vertices
  double jitter = 0.06;        ///< noise of the start positions, m
  double shear = 0;  ///< amplitude of a shift along x that varies along y, times the sheet's number, m
};

constexpr int kSheets = 4;

using Point = std::array<double, 3>;

/// A vertex at t = 0 and t = 1.
struct Motion {
  Point start, end;
};

/// Vertex (a, b) of sheet l; `attempt` > 0 draws its noise anew.
Motion lattice_vertex(const Parameters&, int l, std::int64_t a, std::int64_t b, int attempt);

/// A moving mesh of edges, positions rounded to float32.
struct EdgeMesh {
  std::vector<std::array<float, 3>> x0, x1;
  std::vector<std::array<std::int32_t, 2>> edges;
};

/// Where vertex `v` moves when it is drawn for the `attempt`-th time.
using DrawVertex = std::function<Motion(std::int64_t v, int attempt)>;

/// Draws every vertex and then, until none is left, anew each vertex of an edge pair whose events rounding
/// in FP32 could add, remove or displace badly (specification: "Inputs" of ccd_ee). Throws Error(internal)
/// if that does not end.
void settle(EdgeMesh& mesh, std::int64_t vertices, const DrawVertex& draw);

/// The sheets with their lattice edges (along a, along b, along a + b): vertices and edges in random order,
/// the ends of an edge in random order, ambiguous events removed.
EdgeMesh edge_mesh(const Parameters&);

/// A moving mesh of vertices, and of edges (2 corners) or triangles (3 corners) that they are tested against;
/// with 1 corner the vertices are tested against each other. Positions rounded to float32.
struct Mesh {
  int corners = 1;
  std::vector<std::array<float, 3>> x0, x1;
  std::vector<std::int32_t> primitives;  ///< corners of each, one after the other; none for 1 corner
};

/// As settle() above, for the events of ccd_vv, ccd_ve or ccd_vf by the number of corners ("Inputs" of their
/// specifications). `d`: the distance of contact, not used for triangles.
void settle(Mesh& mesh, std::int64_t vertices, double d, const DrawVertex& draw);

/// The sheets with their lattice edges or with two triangles for each square, all in random order, corners of
/// a primitive as well; ambiguous events removed.
Mesh sheet_mesh(const Parameters&, int corners, double d);

/// Random order of `count` items under `seed`: the item at each place.
std::vector<std::int64_t> random_order(std::uint64_t seed, std::uint64_t stream, std::int64_t count);

}  // namespace gpuphys::cloth_sheets
