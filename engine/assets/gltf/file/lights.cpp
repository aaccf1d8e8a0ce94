// KHR_lights_punctual: lights, and the nodes that have them.
#include "engine/assets/gltf/file/values.h"
#include "engine/assets/input/messages.h"
#include "engine/shading/types.h"

#include <fmt/format.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <utility>

namespace raynest::gltf {
namespace {

/// Brighter lights would make the power of all lights infinite. The sun has 3e27 candela.
constexpr float intensity_most = 1e30F;

/// Cones as the extension wants them: 0 <= inner < outer <= half of pi. Those of a kind without
/// them are left alone.
bool read_cone(const tinygltf::SpotLight& spot, LightRecord& light) {
    const double inner = spot.innerConeAngle;
    const double outer = spot.outerConeAngle;
    if (!(inner >= 0 && outer > 0 && inner <= outer && outer <= std::numbers::pi / 2 + 1e-4))
        return false;
    for (const auto& [name, angle] : {std::pair{"inner_cosine", inner}, {"outer_cosine", outer}})
        if (float* cosine = light_number(light, name))
            *cosine = static_cast<float>(std::cos(angle));
    return true;
}

/// Reads the numbers that the light's kind has for itself.
void read_numbers(const tinygltf::Value& extras, const std::string& where, LightRecord& light,
                  Model& model) {
    const tinygltf::Value* const own = member(extras, "raynest");
    if (own == nullptr) return;
    for (const LightNumber& number : light_numbers(light.kind)) {
        const tinygltf::Value* const given = member(*own, number.name);
        if (given == nullptr) continue;
        const auto value = given->IsNumber() ? static_cast<float>(given->GetNumberAsDouble())
                                             : std::numeric_limits<float>::quiet_NaN();
        if (value >= number.least && value <= number.most)
            *light_number(light, number.name) = value;
        else
            model.odd.add(where,
                          fmt::format("extras.raynest.{} is not from {:g} to {:g}; {:g} is "
                                      "used",
                                      number.name, number.least, number.most, number.otherwise));
    }
}

}  // namespace

Result<void> convert_lights(tinygltf::Model& file, Model& model) {
    for (const tinygltf::Light& in : file.lights) {
        Light light;
        light.name = one_line(in.name);
        const std::string where = label("light", model.lights.size(), in.name);
        std::string kind = in.type;
        if (const std::string own = raynest_extra(in.extras, "light"); !own.empty()) {
            if (light_kind(own)) {
                kind = own;
            } else {
                model.odd.add(where,
                              fmt::format("extras.raynest.light names '{}'; this build has {}",
                                          one_line(own, 60), light_names()));
            }
        }
        const auto known = light_kind(kind);
        if (!known) {
            light.fault = fmt::format("has the unknown type '{}'", one_line(kind, 60));
        } else {
            set_kind(light.record, *known);
            read_numbers(in.extras, where, light.record, model);
        }
        glm::dvec3 colour(1);
        if (in.color.size() == 3) colour = {in.color[0], in.color[1], in.color[2]};
        const glm::dvec3 intensity = colour * in.intensity;
        for (int c = 0; c < 3; ++c) {
            const auto value = static_cast<float>(intensity[c]);
            if (!(value >= 0 && value <= intensity_most))
                light.fault = fmt::format(
                    "has a colour or intensity that is negative, not finite or beyond {:g}",
                    intensity_most);
            light.record.intensity[c] = value;
        }
        const auto range = static_cast<float>(in.range);
        if (range >= 0 && std::isfinite(range))
            light.record.range = range;
        else
            model.odd.add(where, "its range is negative or not finite; it shines endlessly");
        if (in.type == "spot" && !read_cone(in.spot, light.record))
            model.odd.add(where,
                          in.spot.innerConeAngle == cone_of_no_spot
                              ? "it has no member spot; cone angles of 0 and 45 degrees are used"
                              : "its cone angles are out of range; 0 and 45 degrees are used");
        model.lights.push_back(std::move(light));
    }
    // Nodes are there already: the light of each.
    for (std::size_t i = 0; i < file.nodes.size() && i < model.nodes.size(); ++i) {
        const auto* index = member(file.nodes[i].extensions, "KHR_lights_punctual", "light");
        if (index == nullptr) continue;
        const auto light =
            index->IsInt() ? optional_index(index->GetNumberAsInt(), model.lights.size(), "light")
                           : Result<std::uint32_t>(no_id);
        if (light && *light != no_id) {
            model.nodes[i].light = *light;
        } else {
            model.odd.add(label("node", i, file.nodes[i].name),
                          "names a light that does not exist; it has none");
        }
    }
    return {};
}

}  // namespace raynest::gltf
