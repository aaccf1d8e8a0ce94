#include "engine/shading/types.h"

#include "engine/shading/lights.h"
#include "engine/shading/materials.h"
#include "engine/shading/texture_lookup.h"

#include <array>
#include <cmath>

namespace raynest {
namespace {

constexpr std::array materials = {
#define RAYNEST_MATERIAL(name, Type) #name,
#include "engine/shading/materials.def"
};
constexpr std::array lights = {
#define RAYNEST_LIGHT(name, Type) #name,
#include "engine/shading/lights.def"
};

template <class Names>
std::optional<std::uint32_t> kind_of(const Names& names, std::string_view name) {
    for (const char* known : names)
        if (name == known) return shading_type(known);
    return std::nullopt;
}

template <class Names>
std::string joined(const Names& names) {
    std::string text;
    for (const char* name : names) text.append(text.empty() ? "" : ", ").append(name);
    return text;
}

}  // namespace

std::uint32_t default_material() {
    return shading_type(materials.front());
}

std::optional<std::uint32_t> material_kind(std::string_view name) {
    return kind_of(materials, name);
}

std::optional<std::uint32_t> light_kind(std::string_view name) {
    return kind_of(lights, name);
}

std::string material_names() {
    return joined(materials);
}

std::string light_names() {
    return joined(lights);
}

const std::array<float, 256>& srgb_to_linear() {
    static const std::array<float, 256> table = [] {
        std::array<float, 256> t{};
        for (std::size_t i = 0; i < t.size(); ++i) {
            const float s = static_cast<float>(i) / 255.0F;
            t[i] = s <= 0.04045F ? s / 12.92F : std::pow((s + 0.055F) / 1.055F, 2.4F);
        }
        return t;
    }();
    return table;
}

}  // namespace raynest
