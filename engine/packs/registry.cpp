// Finds and loads packs, and keeps the variants that this CPU can run, best target first.
#include "engine/packs/registry.h"

#include "engine/packs/declarations.h"
#include "engine/packs/load.h"

#include <cstdlib>
#include <iterator>
#include <map>
#include <sstream>

namespace raynest {
namespace {

/// True if an object has records. Objects are in the order of their records.
bool has_records(const SceneView& scene) {
    if (scene.object_count == 0) return false;
    const ObjectRecord& last = scene.objects[scene.object_count - 1];
    return last.first_record + records_bytes(last) != 0;
}

// A variant runs on the last target that has it.
constexpr std::string_view cpu_target_names[] = {
#define RAYNEST_CPU_TARGET(name, ...) #name,
#include "engine/packs/targets.def"
};

/// Returns the rank of a target, 0 for the best.
std::size_t rank_of(std::string_view target) {
    const auto found =
        std::find(std::rbegin(cpu_target_names), std::rend(cpu_target_names), target);
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

struct LoadedPack {
    const Pack* pack;
    std::string file;
};

/// Refuses what two packs call by one name: intersectors of one target, and primitives of different
/// sizes, because kernels step over records by the size that their own pack has.
Result<void> check_names(std::span<const LoadedPack> loaded) {
    std::map<std::string, const LoadedPack*> owners;
    std::map<std::string, std::pair<const LoadedPack*, std::uint32_t>> sizes;
    for (const LoadedPack& from : loaded) {
        const auto refuse = [&](const LoadedPack& other, const std::string& what) {
            return fail(ErrorCode::pack_invalid,
                        other.file + " and " + from.file + what +
                            ": rename one of them, or name their folder once");
        };
        const Pack& pack = *from.pack;
        for (const PackPrimitive& primitive : std::span(pack.primitives, pack.primitive_count)) {
            const auto [first, fresh] =
                sizes.try_emplace(primitive.name, &from, primitive.record_size);
            const auto [other, size] = first->second;
            if (size == primitive.record_size) continue;
            return refuse(*other, std::string(" have a primitive named '") + primitive.name +
                                      "', of " + std::to_string(size) + " and of " +
                                      std::to_string(primitive.record_size) + " bytes");
        }
        for (const PackVariant& variant : std::span(pack.variants, pack.variant_count)) {
            const auto [first, fresh] =
                owners.try_emplace(std::string(pack.target) + " " + variant.name, &from);
            if (fresh) continue;
            return refuse(*first->second, std::string(" both have an intersector named '") +
                                              variant.name + "' for target " + pack.target);
        }
    }
    return {};
}

std::string join(const std::vector<std::string>& names) {
    std::string text;
    for (const std::string& name : names) text += (text.empty() ? "" : ", ") + name;
    return text;
}

}  // namespace

std::string_view arithmetic_of(std::string_view target) {
    return target == "v2" ? "v2" : "v3";
}

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
    std::vector<std::filesystem::path> dirs{options.packs.empty() ? builtin_pack_directory()
                                                                  : options.packs};
    dirs.insert(dirs.end(), options.pack_dirs.begin(), options.pack_dirs.end());
    if (const char* more = std::getenv("RAYNEST_PACK_PATH"); more != nullptr) {
        std::stringstream list(more);
        for (std::string dir; std::getline(list, dir, ':');) {
            if (!dir.empty()) dirs.emplace_back(dir);
        }
    }
    const auto files = find_packs(dirs);
    if (!files) return tl::unexpected(files.error());

    std::vector<LoadedPack> loaded;
    bool target_seen = false;
    for (const auto& file : *files) {
        const auto pack = load_pack(file);
        if (!pack) return tl::unexpected(pack.error());
        // GPU packs are used only if the target is named.
        const bool wanted =
            automatic ? is_of_cpu((*pack)->target) : options.target == (*pack)->target;
        target_seen = target_seen || options.target == (*pack)->target;
        if (!wanted || !(*pack)->supported()) continue;
        if (auto sound = check_declarations(**pack, file); !sound)
            return tl::unexpected(sound.error());
        loaded.push_back({*pack, file.string()});
    }
    if (loaded.empty()) {
        return fail(
            ErrorCode::pack_invalid,
            automatic ? "no kernel pack for this CPU in " + dirs.front().string() +
                            ": build the target raynest_packs"
            : target_seen
                ? "this machine does not run target " + options.target + ": use --target auto"
                : "no kernel pack for target " + options.target + " in " + dirs.front().string());
    }
    std::stable_sort(loaded.begin(), loaded.end(), [](const LoadedPack& a, const LoadedPack& b) {
        return rank_of(a.pack->target) < rank_of(b.pack->target);
    });
    if (auto apart = check_names(loaded); !apart) return tl::unexpected(apart.error());

    auto registry = std::shared_ptr<Registry>(new Registry);
    for (const LoadedPack& from : loaded) {
        registry->packs_.push_back(from.pack);
        registry->add_variants(*from.pack);
    }
    return std::shared_ptr<const Registry>(std::move(registry));
}

void Registry::add_variants(const Pack& pack) {
    for (const PackVariant& code : std::span(pack.variants, pack.variant_count)) {
        const auto known =
            std::find_if(variants_.begin(), variants_.end(),
                         [&](const Variant& variant) { return variant.name == code.name; });
        if (known != variants_.end()) {
            known->targets.emplace_back(pack.target);
            continue;
        }
        Variant variant;
        variant.code = &code;
        variant.name = code.name;
        variant.text = code.text;
        variant.target = pack.target;
        variant.targets.emplace_back(pack.target);
        for (const PackPrimitive& primitive : std::span(pack.primitives, pack.primitive_count))
            variant.record_types.push_back(primitive_type(primitive.name));
        variants_.push_back(std::move(variant));
    }
}

const Variant* Registry::find(std::string_view name) const {
    const auto at = std::find_if(variants_.begin(), variants_.end(),
                                 [&](const Variant& variant) { return variant.name == name; });
    return at == variants_.end() ? nullptr : &*at;
}

Result<const Variant*> Registry::choose(std::string_view name, const SceneView& scene) const {
    const bool automatic = name.empty() || name == "auto";
    if (automatic)
        name = scene.masked_materials > scene.blended_materials ? "alpha_mask" : "opaque";
    const Variant* variant = find(name);
    if (variant == nullptr) {
        std::vector<std::string> names;
        for (const Variant& known : variants_) names.push_back(known.name);
        return fail(ErrorCode::variant_unknown,
                    "no intersector '" + std::string(name) + "'; there are: " + join(names));
    }
    auto knows = check_types(*variant, scene);
    if (!knows && automatic) {
        const auto other = std::find_if(
            variants_.begin(), variants_.end(),
            [&](const Variant& candidate) { return check_types(candidate, scene).has_value(); });
        if (other != variants_.end()) return &*other;
    }
    if (!knows) return tl::unexpected(knows.error());
    return variant;
}

Result<void> Registry::check_types(const Variant& variant, const SceneView& scene) const {
    // A scene of triangles alone may have a million objects, and jobs ask for each request.
    if (!has_records(scene)) return {};
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
        if (variant.knows(type)) continue;
        return fail(ErrorCode::variant_unknown,
                    "intersector '" + variant.name + "' was not compiled for primitives of type " +
                        (primitive != nullptr ? primitive->name
                                              : std::string("#").append(std::to_string(type))) +
                        ": " + advice_for(type));
    }
    return {};
}

std::string Registry::advice_for(std::uint32_t type) const {
    std::vector<std::string> names;
    for (const Variant& variant : variants_) {
        if (variant.knows(type)) names.push_back(variant.name);
    }
    return names.empty() ? "load the pack that has it" : "use " + join(names);
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
