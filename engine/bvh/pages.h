// Memory for what is large and read at random: trees, leaves, scenes.
#pragma once

#include "engine/system/child_process.h"

#include <cstddef>
#include <span>

namespace raynest {

/// Bytes of a huge page, and what it takes at least to be worth one.
inline constexpr std::size_t huge_page = std::size_t{2} << 20;

/// Zero-filled memory of at least a huge page, aligned to huge pages and asking for them. Throws
/// std::bad_alloc.
[[nodiscard]] std::byte* map_huge(std::size_t size);
void unmap_huge(void* data, std::size_t size) noexcept;

/// Bytes that many Pages may begin with, in the memory once. Immutable, thread-safe.
class SharedPages {
public:
    /// Copies the bytes. Throws std::bad_alloc.
    explicit SharedPages(std::span<const std::byte> bytes);
    [[nodiscard]] std::size_t size() const { return size_; }

private:
    friend class Pages;
    std::size_t size_;
    Fd file_;
};

/// Anonymous zero-filled memory, from 2 MiB on aligned to huge pages and asking for them (+2..9 %,
/// up to +20 % on random rays, measured). Untouched pages cost nothing.
/// Move-only.
class Pages {
public:
    Pages() = default;
    explicit Pages(std::size_t size);  ///< throws std::bad_alloc
    /// Memory with these bytes. A page (4 KiB, none of them huge) takes memory of its own once it is
    /// written. Throws std::bad_alloc.
    explicit Pages(const SharedPages& beginning);
    Pages(Pages&& other) noexcept;
    Pages& operator=(Pages&& other) noexcept;
    Pages(const Pages&) = delete;
    ~Pages();
    [[nodiscard]] std::byte* data() { return data_; }
    [[nodiscard]] const std::byte* data() const { return data_; }
    [[nodiscard]] std::size_t size() const { return size_; }
    /// True if they were made of SharedPages.
    [[nodiscard]] bool is_shared() const { return is_shared_; }

    /// How many of the bytes the system has put on huge pages so far; 0 where it does not say.
    /// Reads the process's memory map: for a log line, not for a loop.
    [[nodiscard]] std::size_t huge_bytes() const;

private:
    std::byte* data_ = nullptr;
    std::size_t size_ = 0;
    std::size_t mapped_ = 0;
    bool is_shared_ = false;
};

}  // namespace raynest
