// A kernel pack that is refused: its "sphere" is not the built-in one, or its layout of the type
// RAYNEST_TEST_ODD_TYPE differs, or its intersector has an output RAYNEST_TEST_ODD_NAME.
#include "engine/packs/layout.h"

#include <string_view>

namespace {

using namespace raynest;

constexpr PackPrimitive sphere{"sphere", 4, 1, nullptr, nullptr};

#ifdef RAYNEST_TEST_ODD_NAME
constexpr PackOutput output{RAYNEST_TEST_ODD_NAME, "", value_u32};
#endif

PackVariant odd_variant() {
    PackVariant variant{};
    variant.name = "odd";
    variant.text = "";
#ifdef RAYNEST_TEST_ODD_NAME
    variant.outputs = &output;
    variant.output_count = 1;
#endif
    return variant;
}

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
    static const PackVariant variant = odd_variant();
    static const Pack pack{pack_abi,
                           static_cast<std::uint32_t>(types.size()),
                           types.data(),
                           "v2",
                           0,
                           []() noexcept { return true; },
                           &variant,
                           1,
                           1,
                           &sphere};
    return &pack;
}
