// Owned bytes as the protocol needs them: 64-byte aligned and not initialised.
//
// FlatBuffers' verifier checks offsets relative to the start of the buffer only, so the start
// itself must be aligned (a buffer at +1 "verifies" and is then read misaligned). Not initialising
// means that an announced but never sent bulk part costs address space, not memory.
#pragma once

#include <cstddef>
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
    explicit Buffer(std::size_t size)
        : data_(size == 0
                    ? nullptr
                    : static_cast<std::byte*>(::operator new (size, std::align_val_t{alignment}))),
          size_(size) {}
    Buffer(Buffer&& other) noexcept
        : data_(std::exchange(other.data_, nullptr)),
          size_(std::exchange(other.size_, 0)) {}
    Buffer& operator=(Buffer&& other) noexcept {
        std::swap(data_, other.data_);
        std::swap(size_, other.size_);
        return *this;
    }
    Buffer(const Buffer&) = delete;
    Buffer& operator=(const Buffer&) = delete;
    ~Buffer() { ::operator delete (data_, std::align_val_t{alignment}); }

    [[nodiscard]] std::byte* data() { return data_; }
    [[nodiscard]] const std::byte* data() const { return data_; }
    [[nodiscard]] std::size_t size() const { return size_; }
    [[nodiscard]] std::span<std::byte> span() { return {data_, size_}; }
    [[nodiscard]] std::span<const std::byte> span() const { return {data_, size_}; }

private:
    std::byte* data_ = nullptr;
    std::size_t size_ = 0;
};

}  // namespace raynest::protocol
