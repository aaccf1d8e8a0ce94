// Members of JSON objects that tinygltf keeps as they are: extensions and extras.
#pragma once

#include "engine/assets/gltf/file/convert.h"

#include <array>
#include <string>

namespace raynest::gltf {

/// Returns a member of a JSON object, or null.
[[nodiscard]] inline const tinygltf::Value* member(const tinygltf::Value& object,
                                                   const char* name) {
    return object.IsObject() && object.Has(name) ? &object.Get(name) : nullptr;
}

/// Reads the numbers of an array; false if the member holds something else.
template <std::size_t count>
bool read_numbers(const tinygltf::Value* value, std::array<double, count>& numbers) {
    if (value == nullptr) return true;
    if (!value->IsArray() || value->ArrayLen() != count) return false;
    for (std::size_t i = 0; i < count; ++i) {
        const tinygltf::Value& number = value->Get(static_cast<int>(i));
        if (!number.IsNumber()) return false;
        numbers[i] = number.GetNumberAsDouble();
    }
    return true;
}

/// Returns `extras.raynest.<name>` as text; empty if it is none.
[[nodiscard]] inline std::string raynest_extra(const tinygltf::Value& extras, const char* name) {
    const tinygltf::Value* const own = member(extras, "raynest");
    const tinygltf::Value* const value = own == nullptr ? nullptr : member(*own, name);
    return value != nullptr && value->IsString() ? value->Get<std::string>() : std::string();
}

/// Reads KHR_texture_transform as two rows of an affine map, and its set of texture coordinates.
/// False, with the arguments as they were, if it has missing or invalid numbers.
bool read_uv_transform(const tinygltf::Value& transform, float (&rows)[6], std::uint32_t& texcoord);

/// Reads all of a material but its base colour and alpha. Values out of range get the nearest one
/// within, and a line in model.odd.
Result<void> convert_surface(const tinygltf::Material& in, const std::string& where, Model& model,
                             MaterialDescription& material);

}  // namespace raynest::gltf
