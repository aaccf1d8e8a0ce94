// Pages and sections of an arena, as sets.
#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace raynest {

/// Numbers of pages. A set for other bytes than it was made for must not be given to it.
class PageSet {
public:
    /// As the system copies them where they are written.
    static constexpr std::size_t page_bytes = 4096;

    PageSet() = default;
    /// An empty set for an arena of so many bytes.
    explicit PageSet(std::size_t bytes)
        : words_((bytes + page_bytes * 64 - 1) / (page_bytes * 64)) {}

    /// Adds the pages that hold the bytes [first, last], by their offsets in the arena.
    void add(std::size_t first, std::size_t last) {
        for (std::size_t page = first / page_bytes; page <= last / page_bytes; ++page)
            words_[page / 64] |= std::uint64_t{1} << page % 64;
    }
    /// Adds those of another set, for the same arena or empty.
    void add(const PageSet& other) {
        if (words_.empty()) words_.resize(other.words_.size());
        for (std::size_t i = 0; i < other.words_.size(); ++i) words_[i] |= other.words_[i];
    }
    [[nodiscard]] std::size_t bytes() const {
        std::size_t pages = 0;
        for (const std::uint64_t word : words_)
            pages += static_cast<std::size_t>(std::popcount(word));
        return pages * page_bytes;
    }
    /// Calls visit(offset of the first byte) for each page, in order.
    template <class Visit>
    void for_each(Visit&& visit) const {
        for (std::size_t i = 0; i < words_.size(); ++i)
            for (std::uint64_t word = words_[i]; word != 0; word &= word - 1)
                visit((i * 64 + static_cast<std::size_t>(std::countr_zero(word))) * page_bytes);
    }

private:
    std::vector<std::uint64_t> words_;
};

/// In what two arenas of one layout differ.
struct ArenaChanges {
    PageSet pages;
    std::uint32_t sections = 0;  ///< by format::Section; a page may hold parts of several

    void add(const ArenaChanges& other) {
        pages.add(other.pages);
        sections |= other.sections;
    }
};

}  // namespace raynest
