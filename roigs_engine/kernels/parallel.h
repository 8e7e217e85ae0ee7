// The kernels' thread pool: only a parallel loop with dynamic scheduling.
//
// Why not OpenMP: torch has its own OpenMP runtime. Two such runtimes in one process compete for
// the cores (or crash on macOS). And our bundled compilers do not have one for every platform.
//
// Rules for the body of a loop
//   * It runs once for each task in [0, tasks), in any order, on any thread.
//   * It throws nothing: all kernels are compiled without exceptions (see runtime.cpp).
//   * Results must not depend on which thread runs a task. So write to slots owned by the task, and
//     add partial sums in task order afterwards. Then every result is the same at any number of
//     threads; tests check this bit for bit.
//   * `thread_local` scratch is fine: the pool's threads live as long as the process.
//   * A parallel_for inside a body runs serially on the thread it is called from.
#pragma once

#include <cstdint>

#ifndef ROIGS_API
#ifdef _WIN32
#define ROIGS_API extern "C" __declspec(dllexport)
#else
#define ROIGS_API extern "C" __attribute__((visibility("default")))
#endif
#endif

namespace roigs {

// Number of threads that a parallel_for uses, including the calling one. At least 1.
int threads();

namespace detail {
using Task = void (*)(const void* body, int64_t task);

// Runs task(body, i) for i in [0, tasks) on the pool; returns when all have finished.
// Calls from several threads wait for one another.
void run_on_pool(int64_t tasks, Task task, const void* body);
}  // namespace detail

// Calls body(int64_t task) for every task in [0, tasks); returns when all have finished.
template <class F>
void parallel_for(int64_t tasks, const F& body) {
    if (tasks <= 1 || threads() == 1) {  // no pool, no atomics, inlined by the compiler
        for (int64_t task = 0; task < tasks; ++task) body(task);
        return;
    }
    detail::run_on_pool(
        tasks, [](const void* f, int64_t task) { (*static_cast<const F*>(f))(task); }, &body);
}

// Tasks of `size` items that cover [0, items): the number of them, for loops over chunks.
inline int64_t chunks(int64_t items, int64_t size) { return (items + size - 1) / size; }

}  // namespace roigs

// Sets the number of threads (values below 1 count as 1). Takes effect at the next loop.
ROIGS_API void roigs_set_threads(int count);
ROIGS_API int roigs_threads();
