#include "engine/bvh/pages.h"

#include <sys/mman.h>

#include <algorithm>
#include <cstdint>
#include <fstream>
#include <new>
#include <string>
#include <utility>

namespace raynest {
namespace {

constexpr std::size_t huge_page = std::size_t{2} << 20;

std::byte* map(std::size_t size) {
    void* at = mmap(nullptr, size, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (at == MAP_FAILED) throw std::bad_alloc();
    return static_cast<std::byte*>(at);
}

std::size_t round_up(std::size_t size) {
    return size < huge_page ? size : (size + huge_page - 1) / huge_page * huge_page;
}

}  // namespace

Pages::Pages(std::size_t size) : size_(size) {
    if (size == 0) return;
    if (size > SIZE_MAX - 2 * huge_page) throw std::bad_alloc();
    if (size < huge_page) {
        data_ = map(size);
        return;
    }
    // Map one huge page more than needed, keep the aligned part, give the ends back.
    const std::size_t rounded = round_up(size);
    std::byte* const start = map(rounded + huge_page);
    const std::size_t before =
        (huge_page - reinterpret_cast<std::uintptr_t>(start) % huge_page) % huge_page;
    if (before != 0) munmap(start, before);
    if (before != huge_page) munmap(start + before + rounded, huge_page - before);
    data_ = start + before;
    madvise(data_, rounded, MADV_HUGEPAGE);  // a wish: without huge pages it is only slower
}

Pages::Pages(Pages&& other) noexcept
    : data_(std::exchange(other.data_, nullptr)),
      size_(std::exchange(other.size_, 0)) {}

Pages& Pages::operator=(Pages&& other) noexcept {
    std::swap(data_, other.data_);
    std::swap(size_, other.size_);
    return *this;
}

Pages::~Pages() {
    if (data_ == nullptr) return;
    munmap(data_, round_up(size_));
}

// A mapping is named by a line "first-end permissions ..."; lines of its properties follow. The
// system may have merged ours with a neighbour: then its huge pages are counted at most once.
std::size_t Pages::huge_bytes() const {
    const auto first = reinterpret_cast<std::uintptr_t>(data_);
    std::size_t huge = 0;
    std::ifstream map("/proc/self/smaps");
    std::string line;
    bool ours = false;
    while (std::getline(map, line)) {
        unsigned long long begin = 0, end = 0, kib = 0;
        if (std::sscanf(line.c_str(), "%llx-%llx ", &begin, &end) == 2) {
            ours = begin < first + size_ && first < end;
        } else if (ours && std::sscanf(line.c_str(), "AnonHugePages: %llu kB", &kib) == 1) {
            huge += kib << 10;
        }
    }
    return std::min(huge, size_);
}

}  // namespace raynest
