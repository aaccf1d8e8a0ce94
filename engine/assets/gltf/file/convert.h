// The only file that includes tinygltf, for the files that copy its output into a Model.
//
// tinygltf is a JSON reader, not a validator: it accepts indices, ranges and counts of any value.
#pragma once

#include "engine/assets/gltf/file/model.h"

#include <tiny_gltf.h>

namespace raynest::gltf {

/// Returns the member of an extension object, or null.
const tinygltf::Value* member(const tinygltf::ExtensionMap& extensions, const char* extension,
                              const char* name);

/// Converts numbers of the file to floats; `what` starts the error's message if one does not fit.
Result<float> finite(double value, std::string_view what);
Result<std::vector<float>> finite_list(std::span<const double> values, std::string_view what);

/// Call these in order: accessors before meshes, nodes before skins, and pictures before textures
/// before materials.
Result<void> convert_meshes(tinygltf::Model& file, Model& model);
/// Before meshes: gives primitives the materials of the variant `name`, and lists the variants in
/// model.warnings. scene_invalid: there is none of that name. Empty: none is chosen.
Result<void> choose_variant(tinygltf::Model& file, const std::string& name, Model& model);
/// After nodes and meshes. Refuses nothing.
Result<void> convert_animations(tinygltf::Model& file, Model& model);
Result<void> convert_skins(tinygltf::Model& file, Model& model);
Result<void> convert_textures(tinygltf::Model& file, Model& model);
Result<void> convert_materials(tinygltf::Model& file, Model& model);
/// Lights, and which node has which: after nodes.
Result<void> convert_lights(tinygltf::Model& file, Model& model);

}  // namespace raynest::gltf
