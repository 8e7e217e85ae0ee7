// The kernels as a library for tests: shim_launch runs one.
#include "cuda_shim.h"

#include "roigs.cu"

#include <map>

namespace {

template <class Argument>
std::function<void(const void*)> kernel(void (*function)(Argument)) {
    return [=](const void* argument) { function(*static_cast<const Argument*>(argument)); };
}

const std::map<std::string, std::function<void(const void*)>> kKernels = {
    {"place_camera", kernel(place_camera)},
    {"project", kernel(project)},
    {"list_tiles", kernel(list_tiles)},
    {"begin_tiles", kernel(begin_tiles)},
    {"begin_groups", kernel(begin_groups)},
    {"blend", kernel(blend)},
    {"project_planes", kernel(project_planes)},
    {"blend_surface", kernel(blend_surface)},
    {"surface_gradient", kernel(surface_gradient)},
    {"median_depth", kernel(median_depth)},
    {"weigh", kernel(weigh)},
    {"fold_weights", kernel(fold_weights)},
    {"gradient", kernel(gradient)},
    {"project_backward", kernel(project_backward)},
    {"project_backward_adam", kernel(project_backward_adam)},
    {"loss", kernel(loss)},
    {"loss_gradient", kernel(loss_gradient)},
    {"loss_terms", kernel(loss_terms)},
};

}  // namespace

// Null, or what is wrong.
extern "C" const char* shim_launch(const char* name, int blocks, int threads,
                                   const void* argument) {
    static std::string error;
    const auto& run = kKernels.at(name);
    error = shim::launch(blocks, threads, [&] { run(argument); });
    return error.empty() ? nullptr : error.c_str();
}
