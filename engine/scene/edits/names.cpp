#include "engine/scene/edits/names.h"

#include <fmt/format.h>

#include <string>

namespace raynest {
namespace {

bool matches_whole(std::string_view glob, std::string_view text) {
    // Where the last star began to take letters; a later attempt gives it one more.
    std::size_t star = std::string_view::npos;
    std::size_t taken = 0;
    std::size_t at = 0;
    std::size_t letter = 0;
    while (letter < text.size()) {
        if (at < glob.size() && glob[at] == '*') {
            star = at++;
            taken = letter;
        } else if (at < glob.size() && glob[at] == text[letter]) {
            ++at;
            ++letter;
        } else if (star != std::string_view::npos) {
            at = star + 1;
            letter = ++taken;
        } else {
            return false;
        }
    }
    while (at < glob.size() && glob[at] == '*') ++at;
    return at == glob.size();
}

}  // namespace

bool glob_matches(std::string_view glob, std::string_view text) {
    return matches_whole(glob, text) || matches_whole(std::string(glob) + "/*", text);
}

Result<std::vector<std::uint32_t>> find_instances(const Snapshot& scene, std::string_view glob,
                                                  const std::function<bool()>& stopped) {
    const SceneView& view = scene.view();
    const ObjectRecord& root = view.objects[view.root];
    std::vector<std::uint32_t> found;
    for (std::uint32_t i = 0; i < root.instance_count; ++i) {
        // The longest texts take 30 ms to compare.
        if (stopped()) return fail(ErrorCode::limit_exceeded, "stopped");
        const InstanceRecord& instance = view.instances[root.first_instance + i];
        if (view.objects[instance.object].placement_count == 0) continue;  // it has no path
        const auto steps = expand_path(scene, instance.path_base);
        if (steps && glob_matches(glob, path_name(*steps))) found.push_back(i);
    }
    if (!found.empty()) return found;
    const auto inside = find_path(scene, glob);
    if (inside)
        return fail(ErrorCode::field_invalid,
                    fmt::format("'{}' lies inside of an instance; edits change outermost ones alone",
                                glob));
    if (glob.find('*') == std::string_view::npos)
        return fail(ErrorCode::field_invalid, inside.error().message);
    return fail(ErrorCode::field_invalid, fmt::format("no path is of the form '{}'", glob));
}

}  // namespace raynest
