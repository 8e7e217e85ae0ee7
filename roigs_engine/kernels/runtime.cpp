// The few functions of the C++ library that headers call. So the library need not be linked.
//
// Used only with the bundled compiler (ROIGS_NO_CXX_LIBRARY; see build.py), because compiling its
// C++ library takes longer than compiling all kernels. Headers such as <vector>, <algorithm> and
// <atomic> work as usual. The following are not available (an "undefined symbol" error when
// linking): exceptions, std::thread and std::mutex (os_threads.h has ours), streams, std::string,
// `static` variables in functions whose initial value is computed at run time, and thread_local
// objects with a destructor (hold a pointer that is never freed; pool threads live as long as the
// process).
#ifdef ROIGS_NO_CXX_LIBRARY

#include <cstdarg>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <new>
#ifdef _WIN32
#include <malloc.h>
#endif

namespace {

void* allocate(std::size_t bytes, std::size_t alignment) {
    if (bytes == 0) bytes = 1;
#ifdef _WIN32
    void* memory = _aligned_malloc(bytes, alignment);
#else
    void* memory = nullptr;
    if (posix_memalign(&memory, alignment, bytes) != 0) memory = nullptr;
#endif
    if (!memory) {
        std::fprintf(stderr, "roigs: out of memory (%zu bytes wanted)\n", bytes);
        std::abort();
    }
    return memory;
}

void release(void* memory) {
#ifdef _WIN32
    _aligned_free(memory);
#else
    std::free(memory);
#endif
}

constexpr std::size_t kCacheLine = 64;  // plain `new` aligns to it too, so vectors load faster

std::size_t at_least_cache_line(std::align_val_t alignment) {
    const auto wanted = static_cast<std::size_t>(alignment);
    return wanted > kCacheLine ? wanted : kCacheLine;
}

}  // namespace

void* operator new(std::size_t n) { return allocate(n, kCacheLine); }
void* operator new[](std::size_t n) { return allocate(n, kCacheLine); }
void* operator new(std::size_t n, std::align_val_t a) { return allocate(n, at_least_cache_line(a)); }
void* operator new[](std::size_t n, std::align_val_t a) {
    return allocate(n, at_least_cache_line(a));
}
void operator delete(void* p) noexcept { release(p); }
void operator delete[](void* p) noexcept { release(p); }
void operator delete(void* p, std::size_t) noexcept { release(p); }
void operator delete[](void* p, std::size_t) noexcept { release(p); }
void operator delete(void* p, std::align_val_t) noexcept { release(p); }
void operator delete[](void* p, std::align_val_t) noexcept { release(p); }
void operator delete(void* p, std::size_t, std::align_val_t) noexcept { release(p); }
void operator delete[](void* p, std::size_t, std::align_val_t) noexcept { release(p); }

#ifdef _LIBCPP_VERSION
// Called by header code that would throw an exception if they were on (a vector too long and the
// like).
_LIBCPP_BEGIN_NAMESPACE_STD
void __libcpp_verbose_abort(const char* format, ...) _NOEXCEPT {
    va_list arguments;
    va_start(arguments, format);
    std::vfprintf(stderr, format, arguments);
    va_end(arguments);
    std::abort();
}
_LIBCPP_END_NAMESPACE_STD
#endif

#endif  // ROIGS_NO_CXX_LIBRARY
