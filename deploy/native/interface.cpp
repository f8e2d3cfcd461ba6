// What native_library.py compares when it loads the library, so that the two sides cannot differ.
#include <cmath>
#include <cstring>

#include "gavatar_native.h"
#include "splatting_rule.h"

namespace {

struct StructSize {
  const char* name;
  int64_t bytes;
};
#define GV_SIZE_OF(type) \
  { #type, (int64_t)sizeof(type) }
const StructSize STRUCT_SIZES[] = {
    GV_SIZE_OF(GvGaussians),      GV_SIZE_OF(GvCamera), GV_SIZE_OF(GvOptions),
    GV_SIZE_OF(GvImages),         GV_SIZE_OF(GvReport), GV_SIZE_OF(GvGradients),
    GV_SIZE_OF(GvBackwardReport),
};
#undef GV_SIZE_OF

}  // namespace

GV_API int32_t gv_abi_version(void) { return GV_ABI_VERSION; }
GV_API const char* gv_compiler(void) { return __VERSION__; }

GV_API int64_t gv_struct_size(const char* name) {
  for (const StructSize& one : STRUCT_SIZES)
    if (!std::strcmp(one.name, name)) return one.bytes;
  return -1;
}

GV_API double gv_rule(const char* name) {
  for (const gv::RuleConstant& one : gv::RULE)
    if (!std::strcmp(one.name, name)) return one.value;
  return NAN;
}
