// Loads the native kernel as a program would that knows only its C interface, skins and draws the
// scene of a file, forward and backward, and writes what came out.
//   draw LIBRARY SCENE OUT [ISA]
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <vector>

#include "gavatar_native.h"
#if defined(_WIN32)
#include <windows.h>
static void* symbol(const char* library, const char* name) {
  static HMODULE loaded = LoadLibraryA(library);
  if (!loaded) fprintf(stderr, "%s: LoadLibrary fails, code %lu\n", library, GetLastError()), exit(1);
  return (void*)GetProcAddress(loaded, name);
}
#else
#include <dlfcn.h>
static void* symbol(const char* library, const char* name) {
  static void* loaded = dlopen(library, RTLD_NOW | RTLD_LOCAL);
  if (!loaded) fprintf(stderr, "%s\n", dlerror()), exit(1);
  return dlsym(loaded, name);
}
#endif

static const char* library;

#define GV(name) find<decltype(&name)>(#name)
template <class F>
static F find(const char* name) {
  void* found = symbol(library, name);
  if (!found) fprintf(stderr, "%s lacks %s\n", library, name), exit(1);
  return (F)found;
}

static void check(int32_t code, const char* what) {
  if (code != GV_DONE) fprintf(stderr, "%s returned %d\n", what, code), exit(1);
}

static FILE* scene_file;
template <class T>
static std::vector<T> take(size_t n) {
  std::vector<T> values(n);
  if (fread(values.data(), sizeof(T), n, scene_file) != n) fprintf(stderr, "the scene ends early\n"), exit(1);
  return values;
}

int main(int count, char** arguments) {
  if (count < 4) return fprintf(stderr, "draw LIBRARY SCENE OUT [ISA]\n"), 2;
  library = arguments[1];
  if (GV(gv_abi_version)() != GV_ABI_VERSION) return fprintf(stderr, "another version of the interface\n"), 1;
  if (GV(gv_struct_size)("GvGaussians") != sizeof(GvGaussians)) return fprintf(stderr, "another layout\n"), 1;
  if (!GV(gv_isa_supported)(0)) return fprintf(stderr, "says that this processor lacks SSE4.1\n"), 1;
  if (count > 4) {
    int32_t wanted = -1;
    for (int32_t i = 0; i < GV(gv_isa_count)(); i++)
      if (!strcmp(GV(gv_isa_name)(i), arguments[4]) && GV(gv_isa_supported)(i)) wanted = i;
    if (wanted < 0) return fprintf(stderr, "this processor lacks %s\n", arguments[4]), 3;
    GV(gv_set_isa)(wanted);
  }
  scene_file = fopen(arguments[2], "rb");
  if (!scene_file) return perror(arguments[2]), 1;
  auto sizes = take<int32_t>(4);  // Gaussians, weights of each, joints, 0
  size_t n = sizes[0], slots = sizes[1], joints = sizes[2];
  auto camera = take<GvCamera>(1);
  auto options = take<GvOptions>(1);
  size_t pixels = (size_t)camera[0].width * camera[0].height;
  auto rest = take<float>(3 * n), weight = take<float>(slots * n), transforms = take<float>(12 * joints);
  auto scales = take<float>(3 * n), colors = take<float>(3 * n), opacities = take<float>(n);
  auto quaternions = take<float>(4 * n), upstream = take<float>(3 * pixels);
  auto index = take<int32_t>(slots * n);

  std::vector<float> means(3 * n), color(3 * pixels), alpha(pixels), depth(pixels);
  std::vector<float> gm(3 * n), gs(3 * n), gc(3 * n), go(n), gq(4 * n);
  check(GV(gv_skin)(n, (int32_t)slots, (int32_t)joints, 12, rest.data(), index.data(), weight.data(),
                    transforms.data(), means.data()),
        "gv_skin");
  GvGaussians gaussians{(int64_t)n,       means.data(),       scales.data(), colors.data(),
                        opacities.data(), quaternions.data(), nullptr,       3};
  GvImages images{color.data(), alpha.data(), depth.data(), nullptr};
  GvImages from{upstream.data(), nullptr, nullptr, nullptr};
  GvGradients gradients{gm.data(), gs.data(), gc.data(), go.data(), gq.data()};
  GvReport report;
  GvBackwardReport times;
  GvFrame* frame = GV(gv_frame_new)();
  check(GV(gv_forward)(frame, &gaussians, camera.data(), options.data(), &images, &report), "gv_forward");
  check(GV(gv_backward)(frame, &gaussians, camera.data(), options.data(), &images, &from, &gradients, &times),
        "gv_backward");
  GV(gv_frame_free)(frame);
  FILE* out = fopen(arguments[3], "wb");
  if (!out) return perror(arguments[3]), 1;
  for (auto* values : {&color, &alpha, &depth, &means, &gm, &gs, &gc, &go, &gq})
    fwrite(values->data(), 4, values->size(), out);
  if (fclose(out)) return perror(arguments[3]), 1;
  printf("%s, %d threads, %s: %lld of %lld Gaussians visible\n", GV(gv_isa_name)(GV(gv_isa)()), GV(gv_threads)(),
         GV(gv_compiler)(), (long long)report.visible, (long long)n);
}
