// The readers that turn a Model into a description of a scene.
#pragma once

#include "engine/assets/gltf/file/model.h"
#include "engine/assets/gltf/motion.h"
#include "engine/assets/input/mask_rules.h"
#include "engine/scene/description.h"

#include <vector>

namespace raynest::gltf {

/// Reads the meshes in `used`. The result has one object per mesh of the model, with one geometry
/// per primitive; the geometry is empty for points or lines (counted in `scene.skipped`). The
/// object of an unused mesh has no geometries.
Result<std::vector<ObjectDescription>> read_meshes(const Model& model,
                                                   const std::vector<bool>& used,
                                                   const ImportLimits& limits, MotionWriter& motion,
                                                   SceneDescription& scene);

/// Reads materials, their textures and the pictures that those need, decoded. A missing or damaged
/// texture is counted in skipped["textures"] and causes a warning.
Result<void> read_materials(const Model& model, const ImportLimits& limits,
                            SceneDescription& scene);

/// Reads the lights of the chosen scene.
void read_lights(const Model& model, MotionWriter& motion, SceneDescription& scene);

/// Reads objects, instances, cameras and lights of the chosen scene, and what moves of them; `rules`
/// set masks.
Result<void> read_nodes(const Model& model, const ImportLimits& limits, MaskRules& rules,
                        SceneDescription& scene);

}  // namespace raynest::gltf
