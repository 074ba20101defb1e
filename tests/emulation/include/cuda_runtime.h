// Stands in for CUDA's header when a reference is built for the CPU (tests/emulation/README.md).
#pragma once
#include "tests/emulation/builtins.hpp"
#include "tests/emulation/ptx.hpp"
#include "tests/emulation/runtime.hpp"
