// The materials and lights that this build knows: materials.def and lights.def, resolved by a switch.
#pragma once

#include "engine/shading/records.h"

#include <optional>
#include <string>
#include <string_view>

namespace raynest {

/// SurfaceRecord::kind of glTF's material.
[[nodiscard]] std::uint32_t default_material();
/// The kind of a material or light of the lists; nothing for an unknown name.
[[nodiscard]] std::optional<std::uint32_t> material_kind(std::string_view name);
[[nodiscard]] std::optional<std::uint32_t> light_kind(std::string_view name);
/// The names of the lists, for messages: "standard, unlit".
[[nodiscard]] std::string material_names();
[[nodiscard]] std::string light_names();

}  // namespace raynest
