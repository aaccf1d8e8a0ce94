#include "engine/system/module_file.h"

#include <elf.h>
#include <fcntl.h>
#include <link.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

namespace raynest {
namespace {

class Descriptor {
public:
    explicit Descriptor(int number) : number_(number) {}
    Descriptor(const Descriptor&) = delete;
    ~Descriptor() {
        if (number_ >= 0) ::close(number_);
    }
    [[nodiscard]] int get() const { return number_; }

private:
    int number_;
};

/// Reads an object at an offset; false if the file has fewer bytes.
bool read_at(const Descriptor& file, std::uint64_t offset, void* bytes, std::size_t size) {
    return ::pread(file.get(), bytes, size, static_cast<off_t>(offset)) ==
           static_cast<ssize_t>(size);
}

/// Returns the size of the file up to the end of its last segment; 0 if it is no shared object of
/// this machine, or has no table of segments.
std::uint64_t bytes_of_segments(const Descriptor& file) {
    ElfW(Ehdr) header{};
    if (!read_at(file, 0, &header, sizeof header) ||
        std::memcmp(header.e_ident, ELFMAG, SELFMAG) != 0 ||
        header.e_ident[EI_CLASS] != (sizeof(void*) == 8 ? ELFCLASS64 : ELFCLASS32) ||
        header.e_phentsize != sizeof(ElfW(Phdr)))
        return 0;
    std::vector<ElfW(Phdr)> segments(header.e_phnum);
    if (!read_at(file, header.e_phoff, segments.data(), segments.size() * sizeof(ElfW(Phdr))))
        return 0;
    std::uint64_t end = 0;
    for (const ElfW(Phdr) & segment : segments)
        if (segment.p_type == PT_LOAD)
            end = std::max(end, std::max(segment.p_offset, segment.p_offset + segment.p_filesz));
    return end;
}

}  // namespace

Result<void> check_module_file(const std::filesystem::path& path) {
    // O_NONBLOCK: a pipe would wait for a writer.
    const Descriptor file(::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
    struct stat status {};
    if (file.get() < 0 || ::fstat(file.get(), &status) != 0) return {};
    if (!S_ISREG(status.st_mode)) return fail(ErrorCode::pack_invalid, "it is no regular file");
    const std::uint64_t needed = bytes_of_segments(file);
    const auto size = static_cast<std::uint64_t>(status.st_size);
    if (size >= needed) return {};
    return fail(ErrorCode::pack_invalid, "it is cut short: it has " + std::to_string(size) +
                                             " of at least " + std::to_string(needed) +
                                             " bytes; build or copy it again");
}

}  // namespace raynest
