// Owned bytes as the protocol needs them: 64-byte aligned and not initialised.
//
// FlatBuffers' verifier checks offsets relative to the start of the buffer only, so the start
// itself must be aligned (a buffer at +1 "verifies" and is then read misaligned). Not initialising
// means that an announced but never sent bulk part costs address space, not memory. Aligned by
// hand: glibc's aligned allocation goes around its caches (85 ns instead of 27, and a small query
// has seven buffers).
#pragma once

#if __has_include(<sanitizer/asan_interface.h>)
#include <sanitizer/asan_interface.h>
#else
#define ASAN_POISON_MEMORY_REGION(start, size) ((void)(start), (void)(size))
#endif

#include <cstddef>
#include <limits>
#include <memory>
#include <new>
#include <span>
#include <utility>

namespace raynest::protocol {

inline constexpr std::size_t alignment = 64;

/// Rounds up to the alignment of blocks; `bytes` must be below 2^64 - 64.
template <class Integer>
[[nodiscard]] constexpr Integer padded(Integer bytes) {
    constexpr Integer mask = static_cast<Integer>(alignment - 1);
    return (bytes + mask) & ~mask;
}

/// Move-only; empty buffers own nothing.
class Buffer {
public:
    Buffer() = default;
    /// Throws std::bad_alloc.
    explicit Buffer(std::size_t size) : size_(size) {
        if (size == 0) return;
        constexpr std::size_t slack = alignment - __STDCPP_DEFAULT_NEW_ALIGNMENT__;
        if (size > std::numeric_limits<std::size_t>::max() - slack) throw std::bad_alloc();
        std::size_t room = size + slack;
        memory_ = ::operator new(room);
        void* aligned = memory_;
        data_ = static_cast<std::byte*>(std::align(alignment, size, aligned, room));
        // So that who reads beside them is found all the same. Nothing without AddressSanitizer.
        ASAN_POISON_MEMORY_REGION(memory_, size + slack - room);
        ASAN_POISON_MEMORY_REGION(data_ + size, room - size);
    }
    Buffer(Buffer&& other) noexcept { *this = std::move(other); }
    Buffer& operator=(Buffer&& other) noexcept {
        std::swap(memory_, other.memory_);
        std::swap(data_, other.data_);
        std::swap(size_, other.size_);
        return *this;
    }
    Buffer(const Buffer&) = delete;
    Buffer& operator=(const Buffer&) = delete;
    ~Buffer() { ::operator delete(memory_); }

    [[nodiscard]] std::byte* data() { return data_; }
    [[nodiscard]] const std::byte* data() const { return data_; }
    [[nodiscard]] std::size_t size() const { return size_; }
    [[nodiscard]] std::span<std::byte> span() { return {data_, size_}; }
    [[nodiscard]] std::span<const std::byte> span() const { return {data_, size_}; }

private:
    void* memory_ = nullptr;
    std::byte* data_ = nullptr;
    std::size_t size_ = 0;
};

}  // namespace raynest::protocol
