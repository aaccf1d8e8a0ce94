// The only file that includes tinygltf; the files that copy what it read into a Model include this.
//
// tinygltf is a JSON reader, not a validator: it accepts indices, ranges and counts of any value.
#pragma once

#include "engine/assets/gltf_model.h"

#include <tiny_gltf.h>

namespace raynest::gltf {

/// The member of an extension object, or null.
const tinygltf::Value* member(const tinygltf::ExtensionMap& extensions, const char* extension,
                              const char* name);

/// Numbers of the file as floats; `what` starts the error's message where one does not fit.
Result<float> finite(double value, std::string_view what);
Result<std::vector<float>> finite_list(std::span<const double> values, std::string_view what);

/// The accessors are converted before the meshes, the nodes before the skins, the pictures before
/// the textures, and those before the materials.
Result<void> convert_meshes(tinygltf::Model& file, Model& model);
Result<void> convert_skins(tinygltf::Model& file, Model& model);
Result<void> convert_textures(tinygltf::Model& file, Model& model);
Result<void> convert_materials(tinygltf::Model& file, Model& model);

}  // namespace raynest::gltf
