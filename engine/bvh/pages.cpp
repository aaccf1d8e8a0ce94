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

/// Maps the beginning of a file, or with -1 empty memory.
std::byte* map(std::size_t size, int file) {
    const int kind = MAP_PRIVATE | (file < 0 ? MAP_ANONYMOUS : 0);
    void* at = mmap(nullptr, size, PROT_READ | PROT_WRITE, kind, file, 0);
    if (at == MAP_FAILED) throw std::bad_alloc();
    return static_cast<std::byte*>(at);
}

std::size_t rounded_up(std::size_t size) {
    return (size + huge_page - 1) / huge_page * huge_page;
}

}  // namespace

std::byte* map_huge(std::size_t size) {
    if (size > SIZE_MAX - 2 * huge_page) throw std::bad_alloc();
    // Map one huge page more than needed, keep the aligned part, give the ends back.
    const std::size_t rounded = rounded_up(size);
    std::byte* const start = map(rounded + huge_page, -1);
    const std::size_t before =
        (huge_page - reinterpret_cast<std::uintptr_t>(start) % huge_page) % huge_page;
    if (before != 0) munmap(start, before);
    if (before != huge_page) munmap(start + before + rounded, huge_page - before);
    std::byte* const data = start + before;
    madvise(data, rounded, MADV_HUGEPAGE);  // a wish: without huge pages it is only slower
    return data;
}

void unmap_huge(void* data, std::size_t size) noexcept {
    munmap(data, rounded_up(size));
}

SharedPages::SharedPages(std::span<const std::byte> bytes) : size_(bytes.size()) {
    auto file = create_memory_file("raynest arena");
    if (!file || !write_all(file->get(), bytes.data(), size_)) throw std::bad_alloc();
    file_ = std::move(*file);
}

Pages::Pages(const SharedPages& beginning)
    : data_(beginning.size() == 0 ? nullptr : map(beginning.size(), beginning.file_.get())),
      size_(beginning.size()),
      mapped_(beginning.size()),
      is_shared_(true) {}

Pages::Pages(std::size_t size) : size_(size), mapped_(size) {
    if (size == 0) return;
    if (size < huge_page) {
        data_ = map(size, -1);
        return;
    }
    data_ = map_huge(size);
    mapped_ = rounded_up(size);
}

Pages::Pages(Pages&& other) noexcept
    : data_(std::exchange(other.data_, nullptr)),
      size_(std::exchange(other.size_, 0)),
      mapped_(std::exchange(other.mapped_, 0)),
      is_shared_(std::exchange(other.is_shared_, false)) {}

Pages& Pages::operator=(Pages&& other) noexcept {
    std::swap(data_, other.data_);
    std::swap(size_, other.size_);
    std::swap(mapped_, other.mapped_);
    std::swap(is_shared_, other.is_shared_);
    return *this;
}

Pages::~Pages() {
    if (data_ == nullptr) return;
    munmap(data_, mapped_);
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
