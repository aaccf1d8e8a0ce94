#include "engine/shading/types.h"

#include "engine/shading/lights.h"
#include "engine/shading/materials.h"
#include "engine/shading/texture_lookup.h"

#include <algorithm>
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
const char* name_of(const Names& names, std::uint32_t kind) {
    for (const char* known : names)
        if (shading_type(known) == kind) return known;
    return nullptr;
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

const char* material_name(std::uint32_t kind) {
    return name_of(materials, kind);
}

const char* light_name(std::uint32_t kind) {
    return name_of(lights, kind);
}

std::span<const LightNumber> light_numbers(std::uint32_t kind) {
    return with_light(kind, []<class Light>(Light /*light*/) -> std::span<const LightNumber> {
        if constexpr (requires { Light::numbers; }) {
            static_assert(Light::numbers.size() <= light_numbers_max);
            return Light::numbers;
        } else {
            return {};
        }
    });
}

void set_kind(LightRecord& light, std::uint32_t kind) {
    light.kind = kind;
    const auto numbers = light_numbers(kind);
    std::ranges::fill(light.own, 0.0F);
    std::ranges::transform(numbers, light.own, &LightNumber::otherwise);
}

float* light_number(LightRecord& light, std::string_view name) {
    const auto numbers = light_numbers(light.kind);
    for (std::size_t i = 0; i < numbers.size(); ++i)
        if (name == numbers[i].name) return &light.own[i];
    return nullptr;
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
