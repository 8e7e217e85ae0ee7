// Thin wrappers of the operating system's mutex, condition and thread.
//
// Why not std::mutex and std::thread: they are in the compiled part of the C++ library. The bundled
// compiler would have to build that library first (30 to 60 seconds during set-up, and ten times
// the size of our kernels). The kernels use only the C++ headers; see runtime.cpp.
#pragma once

#ifdef _WIN32
#define WIN32_LEAN_AND_MEAN
#define NOMINMAX
#include <windows.h>
#else
#include <pthread.h>
#include <unistd.h>
#endif

namespace roigs {

constexpr int kStackBytes = 8 << 20;  // the default is 512 KB on macOS and 1 MB on Windows

#ifdef _WIN32

class Mutex {
public:
    void lock() { AcquireSRWLockExclusive(&handle_); }
    void unlock() { ReleaseSRWLockExclusive(&handle_); }

private:
    friend class Condition;
    SRWLOCK handle_ = SRWLOCK_INIT;
};

class Condition {
public:
    void wait(Mutex& held) { SleepConditionVariableSRW(&handle_, &held.handle_, INFINITE, 0); }
    void notify_one() { WakeConditionVariable(&handle_); }
    void notify_all() { WakeAllConditionVariable(&handle_); }

private:
    CONDITION_VARIABLE handle_ = CONDITION_VARIABLE_INIT;
};

// Starts a detached thread; false when the system refuses.
inline bool start_thread(void (*run)(void*), void* argument) {
    struct Start {
        void (*run)(void*);
        void* argument;
        static DWORD WINAPI enter(void* start) {
            const Start copy = *static_cast<Start*>(start);
            delete static_cast<Start*>(start);
            copy.run(copy.argument);
            return 0;
        }
    };
    auto* start = new Start{run, argument};
    HANDLE thread = CreateThread(nullptr, kStackBytes, Start::enter, start,
                                 STACK_SIZE_PARAM_IS_A_RESERVATION, nullptr);
    if (!thread) {
        delete start;
        return false;
    }
    CloseHandle(thread);
    return true;
}

inline int this_process() { return static_cast<int>(GetCurrentProcessId()); }

#else

class Mutex {
public:
    void lock() { pthread_mutex_lock(&handle_); }
    void unlock() { pthread_mutex_unlock(&handle_); }

private:
    friend class Condition;
    pthread_mutex_t handle_ = PTHREAD_MUTEX_INITIALIZER;
};

class Condition {
public:
    void wait(Mutex& held) { pthread_cond_wait(&handle_, &held.handle_); }
    void notify_one() { pthread_cond_signal(&handle_); }
    void notify_all() { pthread_cond_broadcast(&handle_); }

private:
    pthread_cond_t handle_ = PTHREAD_COND_INITIALIZER;
};

// Starts a detached thread; false when the system refuses.
inline bool start_thread(void (*run)(void*), void* argument) {
    struct Start {
        void (*run)(void*);
        void* argument;
        static void* enter(void* start) {
            const Start copy = *static_cast<Start*>(start);
            delete static_cast<Start*>(start);
            copy.run(copy.argument);
            return nullptr;
        }
    };
    auto* start = new Start{run, argument};
    pthread_attr_t attributes;
    pthread_attr_init(&attributes);
    pthread_attr_setstacksize(&attributes, kStackBytes);
    pthread_attr_setdetachstate(&attributes, PTHREAD_CREATE_DETACHED);
    pthread_t thread;
    const bool started = pthread_create(&thread, &attributes, Start::enter, start) == 0;
    pthread_attr_destroy(&attributes);
    if (!started) delete start;
    return started;
}

inline int this_process() { return static_cast<int>(getpid()); }

#endif

// Holds a mutex for a scope.
class Lock {
public:
    explicit Lock(Mutex& mutex) : mutex_(mutex) { mutex_.lock(); }
    ~Lock() { mutex_.unlock(); }
    Lock(const Lock&) = delete;
    Lock& operator=(const Lock&) = delete;

private:
    Mutex& mutex_;
};

}  // namespace roigs
