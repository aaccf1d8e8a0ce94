// Arrays that are written once, as a whole, by many threads.
#pragma once

#include "engine/bvh/pages.h"

#include <cstddef>
#include <new>
#include <type_traits>
#include <utility>
#include <vector>

namespace raynest {

/// New elements of its containers keep what the memory holds: to zero them first would be a pass of
/// one thread, which takes all pages from the system alone. Huge pages from 2 MiB on.
template <class T>
struct PageAllocator {
    static_assert(std::is_trivially_copyable_v<T>);
    using value_type = T;

    PageAllocator() = default;
    template <class U>
    PageAllocator(const PageAllocator<U>& /*other*/) noexcept {}

    [[nodiscard]] T* allocate(std::size_t count) {
        const std::size_t bytes = count * sizeof(T);
        if (bytes >= huge_page) return reinterpret_cast<T*>(map_huge(bytes));
        return static_cast<T*>(::operator new (bytes, std::align_val_t{alignof(T)}));
    }
    void deallocate(T* data, std::size_t count) noexcept {
        const std::size_t bytes = count * sizeof(T);
        if (bytes >= huge_page) return unmap_huge(data, bytes);
        ::operator delete (data, std::align_val_t{alignof(T)});
    }
    template <class U, class... Args>
    void construct(U* at, Args&&... args) {
        if constexpr (sizeof...(Args) != 0) ::new (at) U(std::forward<Args>(args)...);
    }
    friend bool operator==(const PageAllocator&, const PageAllocator&) { return true; }
};

template <class T>
using PageVector = std::vector<T, PageAllocator<T>>;

}  // namespace raynest
