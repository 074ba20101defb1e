// Asynchronous copies to shared memory: see tests/emulation/builtins.hpp.
#pragma once
#include "tests/emulation/builtins.hpp"
