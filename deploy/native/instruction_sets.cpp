#include "instruction_sets.h"

namespace gv {

#if defined(__x86_64__) && !defined(GV_BASELINE_ONLY)

extern const Kernels kernels_sse4, kernels_avx2, kernels_avx512;

namespace {
// Each with all that setup.py lets the compiler use.
bool supports_sse4() { return __builtin_cpu_supports("sse4.1"); }
bool supports_avx2() {
  return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") &&
         __builtin_cpu_supports("bmi") && __builtin_cpu_supports("bmi2");
}
bool supports_avx512() {
  return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
         __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl") &&
         supports_avx2();
}
}  // namespace

const InstructionSet INSTRUCTION_SETS[] = {
    {"sse4", &kernels_sse4, supports_sse4},
    {"avx2", &kernels_avx2, supports_avx2},
    {"avx512", &kernels_avx512, supports_avx512},
};

#else

extern const Kernels kernels_baseline;

const InstructionSet INSTRUCTION_SETS[] = {
    {"baseline", &kernels_baseline, [] { return true; }},
};

#endif

const int INSTRUCTION_SET_COUNT = sizeof INSTRUCTION_SETS / sizeof INSTRUCTION_SETS[0];

}  // namespace gv
