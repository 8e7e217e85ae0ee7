// The thread pool of parallel_for. parallel.h has its contract.
#include "parallel.h"

#include <algorithm>
#include <atomic>

#include "os_threads.h"

namespace roigs {
namespace {

std::atomic<int> wanted_threads{1};

// True on a thread that is inside a loop's body. A nested loop then runs serially.
thread_local bool inside_loop = false;

class Pool {
public:
    const int process = this_process();

    void run(int64_t tasks, detail::Task task, const void* body) {
        Lock one_loop_at_a_time(callers_);
        {
            Lock lock(state_);
            // The caller takes part, and a loop never needs more helpers than it has other tasks.
            const int helpers = static_cast<int>(std::min<int64_t>(threads() - 1, tasks - 1));
            while (workers_ < helpers && start_thread(work_forever, this)) ++workers_;
            task_ = task;
            body_ = body;
            tasks_ = tasks;
            seats_ = helpers;
            next_.store(0, std::memory_order_relaxed);
            ++loop_;
        }
        work_available_.notify_all();
        take_tasks();

        // All tasks are taken. Do not wait for helpers that have not woken up yet: they find no
        // seat and go on sleeping. If other programs keep the cores busy, waiting for them would
        // cost a scheduler round trip per loop.
        Lock lock(state_);
        seats_ = 0;
        while (busy_ > 0) helpers_done_.wait(state_);
    }

private:
    void take_tasks() {
        inside_loop = true;
        for (int64_t i; (i = next_.fetch_add(1, std::memory_order_relaxed)) < tasks_;)
            task_(body_, i);
        inside_loop = false;
    }

    static void work_forever(void* self) {
        Pool& pool = *static_cast<Pool*>(self);
        Lock lock(pool.state_);
        for (uint64_t last_loop = 0;;) {
            while (pool.loop_ == last_loop || pool.seats_ == 0)
                pool.work_available_.wait(pool.state_);
            last_loop = pool.loop_;
            --pool.seats_;
            ++pool.busy_;
            pool.state_.unlock();
            pool.take_tasks();
            pool.state_.lock();
            if (--pool.busy_ == 0) pool.helpers_done_.notify_one();
        }
    }

    Mutex callers_;  // held for a whole loop, so loops of several callers take turns

    Mutex state_;  // guards everything below except next_
    Condition work_available_, helpers_done_;
    uint64_t loop_ = 0;  // number of the current loop; a worker joins each loop once
    int workers_ = 0;
    int seats_ = 0;  // workers that may still join the current loop
    int busy_ = 0;   // workers inside it

    detail::Task task_ = nullptr;
    const void* body_ = nullptr;
    int64_t tasks_ = 0;
    std::atomic<int64_t> next_{0};
};

// The pool is never destroyed. At process exit, its threads sleep on condition variables, which
// stay valid until the operating system ends the threads. Joining them in a static destructor would
// hang on Windows (the loader lock is held), and race with the interpreter's shutdown elsewhere.
std::atomic<Pool*> current_pool{nullptr};

Pool& pool() {
    Pool* existing = current_pool.load(std::memory_order_acquire);
    // A forked child has none of its parent's threads, so it starts its own pool.
    if (existing && existing->process == this_process()) return *existing;
    Pool* fresh = new Pool;
    if (current_pool.compare_exchange_strong(existing, fresh)) return *fresh;
    delete fresh;  // another thread was first; `fresh` has started no workers yet
    return *existing;
}

}  // namespace

int threads() { return wanted_threads.load(std::memory_order_relaxed); }

namespace detail {

void run_on_pool(int64_t tasks, Task task, const void* body) {
    if (inside_loop) {
        for (int64_t i = 0; i < tasks; ++i) task(body, i);
        return;
    }
    pool().run(tasks, task, body);
}

}  // namespace detail
}  // namespace roigs

void roigs_set_threads(int count) { roigs::wanted_threads = count < 1 ? 1 : count; }

int roigs_threads() { return roigs::threads(); }
