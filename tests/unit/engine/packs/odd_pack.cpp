// A kernel pack that does not match the built-in ones: its "sphere" differs, or its layout of the type
// RAYNEST_TEST_ODD_TYPE.
#include "engine/packs/layout.h"

#include <string_view>

namespace {

using namespace raynest;

constexpr PackPrimitive sphere{"sphere", 4, 1, nullptr, nullptr};

auto odd_types() {
    auto types = border_types();
#ifdef RAYNEST_TEST_ODD_TYPE
    for (TypeLayout& type : types) {
        if (std::string_view(type.name) == RAYNEST_TEST_ODD_TYPE) type.hash ^= 1;
    }
#endif
    return types;
}

}  // namespace

extern "C" [[gnu::visibility("default")]] const raynest::Pack* raynest_pack() noexcept {
    static const auto types = odd_types();
    static const Pack pack{pack_abi,
                           static_cast<std::uint32_t>(types.size()),
                           types.data(),
                           "v2",
                           0,
                           []() noexcept { return true; },
                           nullptr,
                           0,
                           1,
                           &sphere};
    return &pack;
}
