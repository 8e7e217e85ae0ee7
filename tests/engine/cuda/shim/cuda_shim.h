// Runs CUDA kernels on a processor, a block after the other. The threads of a block are fibers, or,
// with SHIM_THREADS, threads: for the thread sanitizer. Barriers, shuffles and shared memory are
// real: a thread that waits for another one does so, and what is not waited for is not there.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>
#include <functional>
#include <string>
#include <vector>

#if defined(SHIM_THREADS)
#include <pthread.h>

#include <atomic>
#include <memory>
#include <thread>
#else
#include <setjmp.h>
#include <ucontext.h>
#endif

#define __global__
#define __device__
#define __forceinline__ inline
#define __launch_bounds__(threads)
#define __shared__ static

struct float4 {
    float x, y, z, w;
};
inline float4 make_float4(float x, float y, float z, float w) { return {x, y, z, w}; }
struct Place {
    unsigned x;
};

#if defined(SHIM_THREADS)
inline thread_local Place threadIdx, blockIdx, blockDim;
#else
inline Place threadIdx, blockIdx, blockDim;
#endif

namespace shim {

constexpr int kWarp = 32, kMostThreads = 1024;

#if defined(SHIM_THREADS)

class Barrier {
public:
    explicit Barrier(int threads) { pthread_barrier_init(&barrier_, nullptr, threads); }
    ~Barrier() { pthread_barrier_destroy(&barrier_); }
    void wait() { pthread_barrier_wait(&barrier_); }

private:
    pthread_barrier_t barrier_;
};

#else

// Fibers in turns; the next one is resumed where it has yielded.
class Fibers {
public:
    static constexpr size_t kStack = 1 << 17;

    // Empty: all have finished; else what is wrong.
    std::string run(int count, const std::function<void()>& body) {
        body_ = &body;
        count_ = count;
        finished_ = idle_ = 0;
        error_.clear();
        states_.resize(count);
        for (int i = 0; i < count; ++i) states_[i] = kNew;
        if (stacks_.size() < kStack * count) stacks_.resize(kStack * count);
        if (!_setjmp(home_)) resume(0);
        return error_;
    }
    void yield() {
        if (++idle_ > 4 * count_) {
            error_ = "threads wait for others that have ended or wait elsewhere";
            _longjmp(home_, 1);
        }
        const int mine = current_;
        if (!_setjmp(places_[mine])) resume(next());
    }
    void progress() { idle_ = 0; }

private:
    enum State { kNew, kRunning, kFinished };

    int next() const {
        int i = current_;
        do i = (i + 1) % count_;
        while (states_[i] == kFinished);
        return i;
    }
    void resume(int i) {
        current_ = i;
        threadIdx.x = i;
        if (states_[i] == kRunning) _longjmp(places_[i], 1);
        states_[i] = kRunning;
        ucontext_t context;
        getcontext(&context);
        context.uc_stack.ss_sp = &stacks_[kStack * i];
        context.uc_stack.ss_size = kStack;
        context.uc_link = nullptr;
        makecontext(&context, &Fibers::enter, 0);
        setcontext(&context);
    }
    static void enter();
    void finish() {
        states_[current_] = kFinished;
        progress();
        if (++finished_ == count_) _longjmp(home_, 1);
        resume(next());
    }

    const std::function<void()>* body_ = nullptr;
    int count_ = 0, finished_ = 0, current_ = 0, idle_ = 0;
    std::string error_;
    std::vector<State> states_;
    std::vector<char> stacks_;
    jmp_buf home_, places_[kMostThreads];
};

inline Fibers fibers;

inline void Fibers::enter() {
    (*fibers.body_)();
    fibers.finish();
}

class Barrier {
public:
    explicit Barrier(int threads) : threads_(threads) {}
    void wait() {
        fibers.progress();
        const int turn = turn_;
        if (++arrived_ == threads_) {
            arrived_ = 0;
            ++turn_;
            return;
        }
        while (turn == turn_) fibers.yield();
    }

private:
    const int threads_;
    int arrived_ = 0, turn_ = 0;
};

#endif

struct Warp {
    Barrier barrier{kWarp};
    uint32_t values[2][kWarp];  // in turns: the next exchange begins while this one is read
    int turn[kWarp] = {};
};

struct Block {
    explicit Block(int threads) : barrier(threads), warps(threads / kWarp), votes(2 * threads) {}
    Barrier barrier;
    std::vector<Warp> warps;
    std::vector<int> votes;
    int turn[kMostThreads] = {};
};
inline Block* block = nullptr;

// What all lanes of the warp give, after all have.
inline const uint32_t* exchange(uint32_t value) {
    Warp& warp = block->warps[threadIdx.x / kWarp];
    const int lane = threadIdx.x % kWarp;
    uint32_t* values = warp.values[warp.turn[lane]++ % 2];
    values[lane] = value;
    warp.barrier.wait();
    return values;
}

inline uint32_t bits(float x) {
    uint32_t b;
    std::memcpy(&b, &x, sizeof b);
    return b;
}
inline float from_bits(uint32_t b) {
    float x;
    std::memcpy(&x, &b, sizeof x);
    return x;
}

// Empty, or what is wrong.
inline std::string launch(int blocks, int threads, const std::function<void()>& body) {
    Block state(threads);
    block = &state;
    std::string error;
#if defined(SHIM_THREADS)
    std::vector<std::thread> pool;
    for (int t = 0; t < threads; ++t)
        pool.emplace_back([&, t] {
            threadIdx.x = t;
            blockDim.x = threads;
            for (int b = 0; b < blocks; ++b) {
                blockIdx.x = b;
                body();
                state.barrier.wait();  // shared memory is the next block's
            }
        });
    for (std::thread& thread : pool) thread.join();
#else
    blockDim.x = threads;
    for (int b = 0; b < blocks && error.empty(); ++b) {
        blockIdx.x = b;
        error = fibers.run(threads, body);
    }
#endif
    block = nullptr;
    return error;
}

}  // namespace shim

inline void __syncthreads() { shim::block->barrier.wait(); }
inline void __syncwarp() { shim::block->warps[threadIdx.x / shim::kWarp].barrier.wait(); }
inline int __syncthreads_or(int vote) {
    const int threads = blockDim.x;
    int* votes = &shim::block->votes[shim::block->turn[threadIdx.x]++ % 2 * threads];
    votes[threadIdx.x] = vote;
    __syncthreads();
    int any = 0;
    for (int t = 0; t < threads; ++t) any |= votes[t];
    return any;
}
inline unsigned __ballot_sync(unsigned, bool vote) {
    const uint32_t* votes = shim::exchange(vote);
    unsigned all = 0;
    for (int i = 0; i < shim::kWarp; ++i) all |= votes[i] << i;
    return all;
}
inline float __shfl_sync(unsigned, float value, int lane) {
    return shim::from_bits(shim::exchange(shim::bits(value))[lane]);
}
inline float __shfl_up_sync(unsigned, float value, int by) {
    const int lane = threadIdx.x % shim::kWarp, from = lane < by ? lane : lane - by;
    return shim::from_bits(shim::exchange(shim::bits(value))[from]);
}
inline float __shfl_down_sync(unsigned, float value, int by) {
    const int lane = threadIdx.x % shim::kWarp, from = lane + by < shim::kWarp ? lane + by : lane;
    return shim::from_bits(shim::exchange(shim::bits(value))[from]);
}
inline int atomicAdd(int* place, int value) {
    return __atomic_fetch_add(place, value, __ATOMIC_RELAXED);
}
inline int __ffs(int x) { return __builtin_ffs(x); }
inline int __float_as_int(float x) { return int(shim::bits(x)); }
inline float __int_as_float(int x) { return shim::from_bits(uint32_t(x)); }
inline float __fdividef(float a, float b) { return a / b; }
