// KHR_materials_variants: a file names several looks, and each primitive its material in some of
// them.
#include "engine/assets/gltf/file/values.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <string>
#include <vector>

namespace raynest::gltf {
namespace {

constexpr const char* extension = "KHR_materials_variants";
/// Names in a message, at most.
constexpr std::size_t listed_max = 20;

std::vector<std::string> variant_names(const tinygltf::Model& file) {
    std::vector<std::string> names;
    const auto* const list = member(file.extensions, extension, "variants");
    for (std::size_t i = 0; list != nullptr && list->IsArray() && i < list->ArrayLen(); ++i) {
        const auto* const name = member(list->Get(static_cast<int>(i)), "name");
        names.push_back(name != nullptr && name->IsString() ? name->Get<std::string>() : "");
    }
    return names;
}

std::string listed(const std::vector<std::string>& names) {
    std::vector<std::string> shown;
    for (std::size_t i = 0; i < std::min(names.size(), listed_max); ++i)
        shown.push_back('\'' + one_line(names[i], 60) + '\'');
    const std::size_t more = names.size() - shown.size();
    return fmt::format("{}{}", fmt::join(shown, ", "),
                       more == 0 ? "" : fmt::format(" and {} more", more));
}

/// Calls visit(mapping, number of a variant) for all that a primitive's mappings name. A number that
/// is none is -1.
template <class Visit>
void each_mapped(const tinygltf::Primitive& primitive, Visit&& visit) {
    const auto* const mappings = member(primitive.extensions, extension, "mappings");
    for (std::size_t i = 0; mappings != nullptr && mappings->IsArray() && i < mappings->ArrayLen();
         ++i) {
        const tinygltf::Value& mapping = mappings->Get(static_cast<int>(i));
        const auto* const list = member(mapping, "variants");
        for (std::size_t k = 0; list != nullptr && list->IsArray() && k < list->ArrayLen(); ++k) {
            const tinygltf::Value& number = list->Get(static_cast<int>(k));
            visit(mapping, number.IsInt() ? number.GetNumberAsInt() : -1);
        }
    }
}

/// Gives a primitive its material in a variant of `count`; the first mapping counts. Returns what is
/// odd about its mappings, or "".
std::string choose_material(tinygltf::Primitive& primitive, std::size_t variant,
                            std::size_t count) {
    std::string odd;
    int chosen = -1;
    bool is_mapped = false;
    each_mapped(primitive, [&](const tinygltf::Value& mapping, int number) {
        const auto* const material = member(mapping, "material");
        if (number < 0 || static_cast<std::size_t>(number) >= count) {
            odd = fmt::format("maps a variant that is not one of the file's {}", count);
        } else if (material == nullptr || !material->IsInt()) {
            odd = "maps variants to no material";
        } else if (static_cast<std::size_t>(number) == variant) {
            if (is_mapped) odd = "maps a variant twice; the first one counts";
            if (!is_mapped) chosen = material->GetNumberAsInt();
            is_mapped = true;
        }
    });
    if (is_mapped) primitive.material = chosen;
    return odd;
}

}  // namespace

Result<void> choose_variant(tinygltf::Model& file, const std::string& name, Model& model) {
    const std::vector<std::string> names = variant_names(file);
    for (const std::string& each : names) model.variants.push_back(one_line(each, 60));
    if (name.empty()) return {};
    if (names.empty())
        return fail(ErrorCode::scene_invalid, "has no KHR_materials_variants: leave out `variant`");
    const auto found = std::ranges::find(names, name);
    if (found == names.end())
        return fail(ErrorCode::scene_invalid, fmt::format("has no variant '{}': it has {}",
                                                          one_line(name, 60), listed(names)));
    const auto variant = static_cast<std::size_t>(found - names.begin());
    if (std::ranges::count(names, name) > 1)
        model.warnings.push_back(fmt::format(
            "several of its variants are named '{}': the first is chosen", one_line(name, 60)));
    for (std::size_t i = 0; i < file.meshes.size(); ++i)
        for (tinygltf::Primitive& primitive : file.meshes[i].primitives)
            if (const auto odd = choose_material(primitive, variant, names.size()); !odd.empty())
                model.odd.add(fmt::format("mesh {}", i), odd);
    model.chosen_variant = variant + 1;
    return {};
}

}  // namespace raynest::gltf
