// Adam from gradients in memory. Training on the kernels takes its step while the gradients are
// made, see projection_backward.cpp.
#include "adam.h"

int64_t roigs_adam(int64_t rows, const roigs::Adam* adam, const uint8_t* visible) {
    using namespace roigs;
    constexpr int64_t kRowsPerTask = 512;  // worth a task, little enough to balance
    std::vector<AdamRows> steps;
    for (int64_t k = 0; k < adam->count; ++k)
        steps.emplace_back(*adam, adam->parameters[k], adam->parameters[k].width);
    const int64_t parts = chunks(rows, kRowsPerTask), tasks = parts * adam->count;
    std::vector<int64_t> broken(tasks, 0);
    parallel_for(tasks, [&](int64_t task) {
        const int64_t k = task / parts, first = task % parts * kRowsPerTask;
        const AdamParameter& parameter = adam->parameters[k];
        broken[task] = steps[k].update(first, std::min(kRowsPerTask, rows - first),
                                       parameter.gradient + first * parameter.width,
                                       visible + first);
    });
    int64_t total = 0;
    for (int64_t count : broken) total += count;
    return total;
}
