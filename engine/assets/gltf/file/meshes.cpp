// Converts tinygltf's meshes and skins into the Model and checks every index.
#include "engine/assets/gltf/file/compressed.h"
#include "engine/assets/gltf/file/convert.h"
#include "engine/assets/input/messages.h"

#include <fmt/format.h>

namespace raynest::gltf {
namespace {

/// Reads morph targets.
Result<void> convert_targets(const tinygltf::Primitive& from, const std::string& where,
                             Model& model, Primitive& to) {
    for (const auto& target : from.targets) {
        to.targets.push_back(empty_target);
        for (std::size_t i = 0; i < morphed_names.size(); ++i) {
            const auto found = target.find(morphed_names[i]);
            if (found == target.end()) continue;
            const auto index = required_index(found->second, model.accessors.size(), "accessor");
            if (index)
                to.targets.back()[i] = *index;
            else if (i != morphed_normal && i != morphed_tangent)
                return error_of(index);
            else
                model.odd.add(where, fmt::format("the {} of a morph target names no accessor; it "
                                                 "changes none",
                                                 morphed_names[i]));
        }
    }
    return {};
}

Result<void> convert_attributes(const tinygltf::Primitive& from, const std::string& where,
                                Model& model, Primitive& to) {
    const auto has = [&](const char* name, std::size_t set) {
        return from.attributes.contains(fmt::format("{}_{}", name, set));
    };
    while (has("JOINTS", to.joint_sets.size()) && has("WEIGHTS", to.joint_sets.size()))
        to.joint_sets.emplace_back();
    for (const AttributePlace& attribute : attributes_of(to)) {
        const auto found = from.attributes.find(attribute.name);
        if (found == from.attributes.end()) continue;
        const auto index = required_index(found->second, model.accessors.size(), "accessor");
        if (index)
            *attribute.accessor = *index;
        else if (!attribute.is_for_shading)
            return error_of(index);
        else
            model.odd.add(where,
                          fmt::format("its {} names no accessor; it has none", attribute.name));
    }
    return {};
}

}  // namespace

std::vector<AttributePlace> attributes_of(Primitive& primitive) {
    std::vector<AttributePlace> places{{"POSITION", &primitive.position, false},
                                       {"TEXCOORD_0", &primitive.texcoords[0], false},
                                       {"TEXCOORD_1", &primitive.texcoords[1], false},
                                       {"COLOR_0", &primitive.colour, false},
                                       {"NORMAL", &primitive.normal, true},
                                       {"TANGENT", &primitive.tangent, true}};
    if (primitive.mode == 0) places.push_back({"_RADIUS", &primitive.radius, false});
    for (std::size_t set = 0; set < primitive.joint_sets.size(); ++set) {
        JointSet& joints = primitive.joint_sets[set];
        places.push_back({fmt::format("JOINTS_{}", set), &joints.joints, false});
        places.push_back({fmt::format("WEIGHTS_{}", set), &joints.weights, false});
    }
    return places;
}

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
            for (const auto convert : {convert_attributes, convert_targets})
                if (auto done = convert(from, where, model, to); !done) return done;
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
