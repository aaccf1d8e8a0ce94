// The memory of a snapshot: anonymous, zero-filled, on huge pages where the system has them.
#include "engine/scene/snapshot.h"

#include <sys/mman.h>

#include <cstdint>
#include <new>
#include <utility>

namespace raynest {
namespace {

constexpr std::size_t huge_page = std::size_t{2} << 20;

std::byte* map(std::size_t size) {
    void* at = mmap(nullptr, size, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (at == MAP_FAILED) throw std::bad_alloc();
    return static_cast<std::byte*>(at);
}

}  // namespace

Arena::Arena(std::size_t size) : size_(size) {
    if (size == 0) return;
    if (size > SIZE_MAX - 2 * huge_page) throw std::bad_alloc();
    if (size < huge_page) {
        data_ = map(size);
        return;
    }
    // Map one huge page more than needed, keep the aligned part, give the ends back.
    const std::size_t rounded = (size + huge_page - 1) / huge_page * huge_page;
    std::byte* const start = map(rounded + huge_page);
    const std::size_t before =
        (huge_page - reinterpret_cast<std::uintptr_t>(start) % huge_page) % huge_page;
    if (before != 0) munmap(start, before);
    if (before != huge_page) munmap(start + before + rounded, huge_page - before);
    data_ = start + before;
    madvise(data_, rounded, MADV_HUGEPAGE);  // a wish: without huge pages it is only slower
}

Arena::Arena(Arena&& other) noexcept
    : data_(std::exchange(other.data_, nullptr)),
      size_(std::exchange(other.size_, 0)) {}

Arena& Arena::operator=(Arena&& other) noexcept {
    std::swap(data_, other.data_);
    std::swap(size_, other.size_);
    return *this;
}

Arena::~Arena() {
    if (data_ == nullptr) return;
    const std::size_t mapped =
        size_ < huge_page ? size_ : (size_ + huge_page - 1) / huge_page * huge_page;
    munmap(data_, mapped);
}

}  // namespace raynest
