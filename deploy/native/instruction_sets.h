// The instruction sets that the kernels are compiled for.
#pragma once
#include "kernels.h"

namespace gv {

struct InstructionSet {
  const char* name;
  const Kernels* kernels;
  bool (*supported)();  // by this processor
};

// From the plainest to the best.
extern const InstructionSet INSTRUCTION_SETS[];
extern const int INSTRUCTION_SET_COUNT;

}  // namespace gv
