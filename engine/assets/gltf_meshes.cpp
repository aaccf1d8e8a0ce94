// Converts tinygltf's meshes and skins into the Model and checks every index.
#include "engine/assets/gltf_compressed.h"
#include "engine/assets/gltf_convert.h"
#include "engine/assets/gltf_names.h"

#include <fmt/format.h>

namespace raynest::gltf {
namespace {

/// Reads morph targets, and the joints and weights of a skin.
Result<void> convert_deformation(const tinygltf::Primitive& from, const std::string& where,
                                 Model& model, Primitive& to) {
    const auto find = [&](const std::map<std::string, int>& attributes, const std::string& name,
                          std::uint32_t& out) -> Result<void> {
        const auto found = attributes.find(name);
        if (found == attributes.end()) return {};
        const auto index = required_index(found->second, model.accessors.size(), "accessor");
        if (!index) return error_of(index);
        out = *index;
        return {};
    };
    for (const auto& target : from.targets) {
        to.targets.push_back(empty_target);
        for (std::size_t i = 0; i < morphed_names.size(); ++i) {
            const auto done = find(target, morphed_names[i], to.targets.back()[i]);
            if (!done && i != morphed_normal && i != morphed_tangent) return done;
            if (!done)
                model.odd.add(where, fmt::format("the {} of a morph target names no accessor; it "
                                                 "changes none",
                                                 morphed_names[i]));
        }
    }
    for (int set = 0;; ++set) {
        JointSet joints;
        for (const auto& done :
             {find(from.attributes, fmt::format("JOINTS_{}", set), joints.joints),
              find(from.attributes, fmt::format("WEIGHTS_{}", set), joints.weights)}) {
            if (!done) return done;
        }
        if (joints.joints == no_id || joints.weights == no_id) return {};
        to.joint_sets.push_back(joints);
    }
}

}  // namespace

Result<void> convert_meshes(tinygltf::Model& file, Model& model) {
    for (const tinygltf::Mesh& in : file.meshes) {
        Mesh mesh;
        mesh.name = one_line(in.name);
        const std::string where = label("mesh", model.meshes.size(), in.name);
        auto weights = finite_list(in.weights, where + ": a morph weight");
        if (!weights) return error_of(weights);
        mesh.weights = std::move(*weights);
        for (const tinygltf::Primitive& from : in.primitives) {
            Primitive to;
            to.mode = from.mode;
            const auto attribute = [&](const char* name, std::uint32_t& out) -> Result<void> {
                const auto found = from.attributes.find(name);
                if (found == from.attributes.end()) return {};
                const auto index =
                    required_index(found->second, model.accessors.size(), "accessor");
                if (!index) return error_of(index);
                out = *index;
                return {};
            };
            for (const auto& result :
                 {attribute("POSITION", to.position), attribute("TEXCOORD_0", to.texcoords[0]),
                  attribute("TEXCOORD_1", to.texcoords[1]), attribute("COLOR_0", to.colour)}) {
                if (!result) return result;
            }
            // Shading alone needs these two: a mesh without them is flat.
            const auto optional = [&](const char* name, std::uint32_t& out) {
                const auto found = from.attributes.find(name);
                if (found == from.attributes.end()) return;
                const auto index = required_index(found->second, model.accessors.size(), "accessor");
                if (index)
                    out = *index;
                else
                    model.odd.add(where, fmt::format("its {} names no accessor; it has none", name));
            };
            optional("NORMAL", to.normal);
            optional("TANGENT", to.tangent);
            if (auto done = convert_deformation(from, where, model, to); !done) return done;
            const auto indices = optional_index(from.indices, model.accessors.size(), "accessor");
            const auto material = optional_index(from.material, file.materials.size(), "material");
            if (!indices) return error_of(indices);
            if (!material) return error_of(material);
            to.indices = *indices;
            to.material = *material;
            if (auto done = decompress(from, model, to); !done) return blame(where, done.error());
            mesh.primitives.push_back(to);
        }
        model.meshes.push_back(std::move(mesh));
    }
    return {};
}

Result<void> convert_skins(tinygltf::Model& file, Model& model) {
    for (const tinygltf::Skin& in : file.skins) {
        Skin skin{one_line(in.name), no_id, {}};
        const auto inverse_bind =
            optional_index(in.inverseBindMatrices, model.accessors.size(), "accessor");
        const auto skeleton = optional_index(in.skeleton, model.nodes.size(), "skeleton node");
        if (!inverse_bind) return error_of(inverse_bind);
        if (!skeleton) return error_of(skeleton);
        skin.inverse_bind = *inverse_bind;
        for (const int joint : in.joints) {
            const auto index = required_index(joint, model.nodes.size(), "joint node");
            if (!index) return error_of(index);
            skin.joints.push_back(*index);
        }
        model.skins.push_back(std::move(skin));
    }
    return {};
}

}  // namespace raynest::gltf
