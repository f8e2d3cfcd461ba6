// The arithmetic, compiled once for every instruction set with GV_NAMESPACE set to its name. Only
// the table at the end leaves this file, and nothing of the standard library is used: what the
// linker might share with the baseline must not contain this file's instructions.
#include "blend-inl.h"
#include "blend_backward-inl.h"
#include "jpeg-inl.h"
#include "kernels.h"
#include "project-inl.h"
#include "project_backward-inl.h"
#include "residuals-inl.h"
#include "skin-inl.h"
#include "sparse-inl.h"
#include "ssim-inl.h"

namespace gv {

#define GV_JOIN2(a, b) a##b
#define GV_JOIN(a, b) GV_JOIN2(a, b)
#define GV_TABLE GV_JOIN(kernels_, GV_NAMESPACE)

constexpr size_t FORWARD_BYTES = sizeof(GV_NAMESPACE::ForwardScratch);
constexpr size_t BACKWARD_BYTES = sizeof(GV_NAMESPACE::BackwardScratch);

extern const Kernels GV_TABLE;
const Kernels GV_TABLE = {
    FORWARD_BYTES > BACKWARD_BYTES ? FORWARD_BYTES : BACKWARD_BYTES,
    GV_NAMESPACE::project,
    GV_NAMESPACE::forward_tile,
    GV_NAMESPACE::write_background,
    GV_NAMESPACE::backward_tile,
    GV_NAMESPACE::backward_project,
    GV_NAMESPACE::skin,
    GV_NAMESPACE::skin_backward,
    GV_NAMESPACE::blendshapes,
    GV_NAMESPACE::upsample,
    GV_NAMESPACE::ssim_scratch_floats,
    GV_NAMESPACE::ssim_plane,
    GV_NAMESPACE::sparse_product,
    GV_NAMESPACE::jpeg_line,
};

}  // namespace gv
