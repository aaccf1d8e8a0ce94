// Packs that were built against other headers are refused, and the refusal names the type.
#include "engine/packs/layout.h"

#include "engine/packs/load.h"
#include "engine/packs/registry.h"

#include <doctest/doctest.h>

#include <set>
#include <string>
#include <vector>

using namespace raynest;

namespace {

namespace before {
struct Sample {
    float a, b;
    std::uint32_t c[2];
    std::uint32_t (*f)(float) noexcept;
};
}  // namespace before
namespace wider {
struct Sample {
    float a, b;
    std::uint32_t c[4];
    std::uint32_t (*f)(float) noexcept;
};
}  // namespace wider
namespace other_kind {
struct Sample {
    float a, b;
    float c[2];
    std::uint32_t (*f)(float) noexcept;
};
}  // namespace other_kind
namespace other_order {
struct Sample {
    float b, a;
    std::uint32_t c[2];
    std::uint32_t (*f)(float) noexcept;
};
}  // namespace other_order
namespace other_offset {
struct Sample {
    float a;
    std::uint32_t c[2];
    float b;
    std::uint32_t (*f)(float) noexcept;
};
}  // namespace other_offset
namespace other_alignment {
struct alignas(32) Sample {
    float a, b;
    std::uint32_t c[2];
    std::uint32_t (*f)(float) noexcept;
};
}  // namespace other_alignment
namespace other_argument {
struct Sample {
    float a, b;
    std::uint32_t c[2];
    std::uint32_t (*f)(std::uint32_t) noexcept;
};
}  // namespace other_argument

}  // namespace

TEST_CASE("the hash of a layout sees sizes, kinds, order, offsets, alignment and signatures") {
    const std::set<std::uint64_t> seen{RAYNEST_LAYOUT(before::Sample, a, b, c, f).hash,
                                       RAYNEST_LAYOUT(wider::Sample, a, b, c, f).hash,
                                       RAYNEST_LAYOUT(other_kind::Sample, a, b, c, f).hash,
                                       RAYNEST_LAYOUT(other_order::Sample, b, a, c, f).hash,
                                       RAYNEST_LAYOUT(other_offset::Sample, a, c, b, f).hash,
                                       RAYNEST_LAYOUT(other_alignment::Sample, a, b, c, f).hash,
                                       RAYNEST_LAYOUT(other_argument::Sample, a, b, c, f).hash};
    CHECK(seen.size() == 7);
    CHECK(RAYNEST_LAYOUT(before::Sample, a, b, c, f).hash ==
          RAYNEST_LAYOUT(before::Sample, a, b, c, f).hash);
}

TEST_CASE("the hash of an enumeration sees names and their order") {
    const std::set<std::uint64_t> seen{
        layout::hash_of_names({"closest", "any"}), layout::hash_of_names({"any", "closest"}),
        layout::hash_of_names({"closest"}), layout::hash_of_names({"closestany"}),
        layout::hash_of_names({"closest", "any", "multi"})};
    CHECK(seen.size() == 5);
}

TEST_CASE("each type of the ABI is named when it alone differs, lacks or is new") {
    const auto types = border_types();
    CHECK(differing_type(types) == "");
    for (std::size_t i = 0; i < types.size(); ++i) {
        const std::string name = types[i].name;
        CAPTURE(name);
        std::vector<TypeLayout> changed(types.begin(), types.end());
        changed[i].hash ^= 1U << 31;
        CHECK(differing_type(changed) == name);
        changed.erase(changed.begin() + static_cast<std::ptrdiff_t>(i));
        CHECK(differing_type(changed) == name);
    }
    std::vector<TypeLayout> more(types.begin(), types.end());
    more.push_back({"Curve", 1});
    CHECK(differing_type(more) == "Curve");
}

TEST_CASE("the list of types has each name once, and every type that kernels read or write") {
    std::set<std::string> names;
    for (const TypeLayout& type : border_types()) CHECK(names.insert(type.name).second);
    for (const char* name : {"SceneView",      "ObjectRecord",   "HitRecord",
                             "TraceCall",      "Counters",       "Ray",
                             "Node",           "TriangleBlock",  "InstanceRecord",
                             "GeometryRecord", "MaterialRecord", "TextureRecord",
                             "TexcoordBlock",  "PackVariant",    "PackParam",
                             "PackPrimitive",  "Device",         "PinholeRays",
                             "Query",          "Traversal"}) {
        CAPTURE(name);
        CHECK(names.contains(name));
    }
}

TEST_CASE("a pack in which one type differs is refused by the name of the type") {
    const auto odd = Registry::load({{RAYNEST_TEST_ODD_TYPE_PACK}, "auto"});
    REQUIRE(!odd);
    CHECK(odd.error().code == ErrorCode::pack_invalid);
    CHECK(
        odd.error().message.find("was built against other engine headers (type Counters differs): "
                                 "rebuild the pack") != std::string::npos);
}
