// Finds and loads packs, and keeps the variants that this CPU can run, best target first.
#include "engine/packs/registry.h"

#include "engine/packs/load.h"

#include <algorithm>
#include <cstdlib>
#include <iterator>
#include <sstream>

namespace raynest {
namespace {

// In the order of pack.cmake: a variant runs on the last target that has it.
constexpr std::string_view cpu_target_names[] = {RAYNEST_CPU_TARGETS};

/// Returns the rank of a target, 0 for the best.
std::size_t rank_of(std::string_view target) {
    const auto found = std::find(std::rbegin(cpu_target_names), std::rend(cpu_target_names), target);
    return static_cast<std::size_t>(found - std::rbegin(cpu_target_names));
}

bool is_of_cpu(std::string_view target) {
    return rank_of(target) != std::size(cpu_target_names);
}

Result<std::vector<std::filesystem::path>> find_packs(
    const std::vector<std::filesystem::path>& dirs) {
    std::vector<std::filesystem::path> found;
    for (const auto& dir : dirs) {
        const auto here = packs_in(dir);
        if (!here) return tl::unexpected(here.error());
        found.insert(found.end(), here->begin(), here->end());
    }
    return found;
}

std::string join(const std::vector<std::string>& names) {
    std::string text;
    for (const std::string& name : names) text += (text.empty() ? "" : ", ") + name;
    return text;
}

}  // namespace

std::span<const std::string_view> cpu_targets() {
    return cpu_target_names;
}

std::filesystem::path builtin_pack_directory() {
    if (const char* set = std::getenv("RAYNEST_BUILTIN_PACKS"); set != nullptr && *set != '\0') {
        return set;
    }
    std::error_code error;
    const auto self = std::filesystem::read_symlink("/proc/self/exe", error);
    return error ? std::filesystem::path("raynest")
                 : self.parent_path().parent_path() / "lib" / "raynest";
}

Result<std::shared_ptr<const Registry>> Registry::load(const Options& options) {
    const bool automatic = options.target == "auto";
    if (!automatic && options.target != "cuda" && !is_of_cpu(options.target)) {
        std::string known = "auto";
        for (const std::string_view name : cpu_target_names) known.append(", ").append(name);
        return fail(ErrorCode::pack_invalid,
                    "unknown target '" + options.target + "': use one of " + known);
    }
    std::vector<std::filesystem::path> dirs{builtin_pack_directory()};
    dirs.insert(dirs.end(), options.pack_dirs.begin(), options.pack_dirs.end());
    if (const char* more = std::getenv("RAYNEST_PACK_PATH"); more != nullptr) {
        std::stringstream list(more);
        for (std::string dir; std::getline(list, dir, ':');) {
            if (!dir.empty()) dirs.emplace_back(dir);
        }
    }
    const auto files = find_packs(dirs);
    if (!files) return tl::unexpected(files.error());

    auto registry = std::shared_ptr<Registry>(new Registry);
    bool target_seen = false;
    for (const auto& file : *files) {
        const auto pack = load_pack(file);
        if (!pack) return tl::unexpected(pack.error());
        // GPU packs are used only if the target is named.
        const bool wanted =
            automatic ? is_of_cpu((*pack)->target) : options.target == (*pack)->target;
        target_seen = target_seen || options.target == (*pack)->target;
        if (wanted && (*pack)->supported()) registry->packs_.push_back(*pack);
    }
    if (registry->packs_.empty()) {
        return fail(
            ErrorCode::pack_invalid,
            automatic ? "no kernel pack for this CPU in " + dirs.front().string() +
                            ": build the target raynest_packs"
            : target_seen
                ? "this machine does not run target " + options.target + ": use --target auto"
                : "no kernel pack for target " + options.target + " in " + dirs.front().string());
    }
    std::stable_sort(
        registry->packs_.begin(), registry->packs_.end(),
        [](const Pack* a, const Pack* b) { return rank_of(a->target) < rank_of(b->target); });

    for (const Pack* pack : registry->packs_) {
        // Refuse different sizes: kernels step over records by the size that their own pack has.
        for (std::uint32_t i = 0; i < pack->primitive_count; ++i) {
            const PackPrimitive& primitive = pack->primitives[i];
            const PackPrimitive* first = registry->find_primitive(primitive.name);
            if (first->record_size == primitive.record_size) continue;
            return fail(ErrorCode::pack_invalid,
                        std::string("two kernel packs have a primitive named '") + primitive.name +
                            "', of " + std::to_string(first->record_size) + " and of " +
                            std::to_string(primitive.record_size) + " bytes: rename one of them");
        }
        for (std::uint32_t i = 0; i < pack->variant_count; ++i) {
            const PackVariant& code = pack->variants[i];
            Variant* known = nullptr;
            for (Variant& variant : registry->variants_) {
                if (variant.name == code.name) known = &variant;
            }
            if (known == nullptr) {
                Variant variant;
                variant.code = &code;
                variant.name = code.name;
                variant.text = code.text;
                variant.target = pack->target;
                for (std::uint32_t p = 0; p < pack->primitive_count; ++p) {
                    variant.record_types.push_back(primitive_type(pack->primitives[p].name));
                }
                known = &registry->variants_.emplace_back(std::move(variant));
            } else if (known->targets.back() == pack->target) {
                return fail(ErrorCode::pack_invalid, "two kernel packs for target " +
                                                         std::string(pack->target) +
                                                         " have an intersector named '" +
                                                         code.name + "': rename one of them");
            }
            known->targets.emplace_back(pack->target);
        }
    }
    return std::shared_ptr<const Registry>(std::move(registry));
}

const Variant* Registry::find(std::string_view name) const {
    const auto at = std::find_if(variants_.begin(), variants_.end(),
                                 [&](const Variant& variant) { return variant.name == name; });
    return at == variants_.end() ? nullptr : &*at;
}

Result<const Variant*> Registry::choose(std::string_view name, const SceneView& scene) const {
    if (name.empty() || name == "auto")
        name = scene.masked_materials != 0 ? "alpha_mask" : "opaque";
    const Variant* variant = find(name);
    if (variant == nullptr) {
        std::vector<std::string> names;
        for (const Variant& known : variants_) names.push_back(known.name);
        return fail(ErrorCode::variant_unknown,
                    "no intersector '" + std::string(name) + "'; there are: " + join(names));
    }
    for (std::uint32_t i = 0; i < scene.object_count; ++i) {
        const std::uint32_t type = scene.objects[i].record_type;
        if (type == 0) continue;
        const PackPrimitive* primitive = find_primitive(type);
        if (primitive != nullptr && primitive->record_size != scene.objects[i].record_size) {
            return fail(ErrorCode::scene_invalid,
                        std::string("the scene's records of type ") + primitive->name + " have " +
                            std::to_string(scene.objects[i].record_size) + " bytes, the pack's " +
                            std::to_string(primitive->record_size) + ": import the scene again");
        }
        if (std::find(variant->record_types.begin(), variant->record_types.end(), type) !=
            variant->record_types.end()) {
            continue;
        }
        return fail(ErrorCode::variant_unknown,
                    "intersector '" + variant->name + "' was not compiled for primitives of type " +
                        (primitive != nullptr ? primitive->name
                                              : std::string("#").append(std::to_string(type))) +
                        ": add the type to the PRIMITIVES of its pack");
    }
    return variant;
}

const PackPrimitive* Registry::find_primitive(std::uint32_t type) const {
    for (const Pack* pack : packs_) {
        for (std::uint32_t i = 0; i < pack->primitive_count; ++i) {
            if (primitive_type(pack->primitives[i].name) == type) return &pack->primitives[i];
        }
    }
    return nullptr;
}

const PackPrimitive* Registry::find_primitive(std::string_view name) const {
    return find_primitive(primitive_type(std::string(name).c_str()));
}

}  // namespace raynest
