#include "server/http/embedded.h"

#include <array>
#include <cstddef>

// embedded.def is written by CMake: one RAYNEST_EMBEDDED(number, name, path) for each file. The
// assembler puts the bytes into the object, so the build needs no tool of its own.
#define RAYNEST_EMBEDDED(number, name, path)                \
    asm(".pushsection .rodata\n"                            \
        ".global raynest_embedded_" #number                 \
        "\n"                                                \
        ".hidden raynest_embedded_" #number                 \
        "\n"                                                \
        "raynest_embedded_" #number ": .incbin \"" path     \
        "\"\n"                                              \
        ".global raynest_embedded_end_" #number             \
        "\n"                                                \
        ".hidden raynest_embedded_end_" #number             \
        "\n"                                                \
        "raynest_embedded_end_" #number                     \
        ": .byte 0\n"                                       \
        ".popsection\n");                                   \
    extern "C" const std::byte raynest_embedded_##number[]; \
    extern "C" const std::byte raynest_embedded_end_##number[];
#include "server/http/embedded.def"
#undef RAYNEST_EMBEDDED

namespace raynest::server {
namespace {

struct File {
    std::string_view name;
    const std::byte* begin;
    const std::byte* end;
};

constexpr std::array files = {
#define RAYNEST_EMBEDDED(number, name, path) \
    File{name, raynest_embedded_##number, raynest_embedded_end_##number},
#include "server/http/embedded.def"
#undef RAYNEST_EMBEDDED
};

}  // namespace

std::string_view embedded_file(std::string_view name) {
    for (const File& file : files)
        if (file.name == name)
            return {reinterpret_cast<const char*>(file.begin),
                    static_cast<std::size_t>(file.end - file.begin)};
    return {};
}

}  // namespace raynest::server
