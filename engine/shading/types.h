// The materials and lights that this build knows: materials.def and lights.def, resolved by a switch.
#pragma once

#include "engine/shading/light.h"

#include <optional>
#include <span>
#include <string>
#include <string_view>

namespace raynest {

/// SurfaceRecord::kind of glTF's material.
[[nodiscard]] std::uint32_t default_material();
/// The kind of a material or light of the lists; nothing for an unknown name.
[[nodiscard]] std::optional<std::uint32_t> material_kind(std::string_view name);
[[nodiscard]] std::optional<std::uint32_t> light_kind(std::string_view name);
/// The name of a kind; null where this build lacks it.
[[nodiscard]] const char* material_name(std::uint32_t kind);
[[nodiscard]] const char* light_name(std::uint32_t kind);
/// The numbers that lights of a kind have for themselves; none for an unknown one.
[[nodiscard]] std::span<const LightNumber> light_numbers(std::uint32_t kind);
/// Makes it a light of that kind, with the defaults of its numbers.
void set_kind(LightRecord& light, std::uint32_t kind);
/// That number of a light; null where its kind has none of that name.
[[nodiscard]] float* light_number(LightRecord& light, std::string_view name);
/// The names of the lists, for messages: "standard, unlit".
[[nodiscard]] std::string material_names();
[[nodiscard]] std::string light_names();

}  // namespace raynest
