// Converts paths to texts and back.
#include "engine/geometry/path.h"

#include "engine/scene/named_paths.h"
#include "engine/scene/snapshot.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <optional>

namespace raynest {
namespace {

bool is_digit(char c) {
    return c >= '0' && c <= '9';
}

/// Returns the number of an instance among those of its name in its object, or no_id.
std::uint32_t number_of(const PathTable& paths, std::uint32_t instance) {
    return paths.numbers == nullptr ? no_id : paths.numbers[instance];
}

/// Returns the range of a node's children, which are neighbours.
std::pair<std::uint32_t, std::uint32_t> children_of(const PathTable& paths, std::uint32_t node) {
    const auto below = [](const PathNode& child, std::uint32_t parent) {
        return child.parent < parent;
    };
    // Node 0 is its own parent.
    const PathNode* const nodes = paths.nodes;
    const PathNode* const end = nodes + paths.node_count;
    const PathNode* const first = std::lower_bound(nodes + 1, end, node, below);
    return {first - nodes, std::lower_bound(first, end, node + 1, below) - nodes};
}

std::vector<PathStep> expand_nodes(const Snapshot& scene, std::uint64_t path) {
    const PathTable& paths = scene.paths();
    const PathRun& run = paths.run_of(path);
    std::vector<PathStep> steps;
    std::size_t bytes = 0;
    for (std::uint32_t at = run.node; at != 0; at = paths.nodes[at].parent) {
        const PathNode& node = paths.nodes[at];
        PathStep& step = steps.emplace_back();
        step.instance = at - children_of(paths, node.parent).first;
        step.uid = step.node = node.source;
        std::uint32_t number = node.number;
        if (at == run.node && number != no_id)
            number = run.number + static_cast<std::uint32_t>(path - run.first_path);
        step.name = numbered(scene.view().names + node.name, number);
        bytes += step.name.size() + 1;
        // Stop at the limits, beyond which steps would be cut: a tree may be a million nodes deep.
        if (steps.size() > path_steps_max || bytes > path_text_bytes_max) break;
    }
    std::reverse(steps.begin(), steps.end());
    return steps;
}

std::vector<PathStep> expand_instances(const Snapshot& scene, std::uint64_t path) {
    const SceneView& view = scene.view();
    std::vector<PathStep> steps;
    const ObjectRecord* parent = &view.objects[view.root];
    walk_path(view, path, [&](std::uint32_t index) {
        const InstanceInfo& info = view.instance_infos[index];
        PathStep& step = steps.emplace_back();
        step.instance = index - parent->first_instance;
        step.uid = info.uid;
        step.name = numbered(view.names + info.name, number_of(scene.paths(), index));
        parent = &view.objects[view.instances[index].object];
    });
    return steps;
}

/// Drops outer steps until the text fits its limits.
void shorten(std::vector<PathStep>& steps) {
    std::size_t bytes = 0;
    std::size_t kept = 0;
    for (; kept < steps.size() && kept < path_steps_max; ++kept) {
        bytes += steps[steps.size() - 1 - kept].name.size() + 1;
        if (bytes > path_text_bytes_max) break;
    }
    if (kept == steps.size()) return;
    steps.erase(steps.begin(), steps.end() - static_cast<std::ptrdiff_t>(kept) - 1);
    steps.front() = PathStep{};
    steps.front().name = "...";
}

/// A step of a text: a name, and perhaps a number.
struct Token {
    std::string_view name;
    std::uint32_t number = no_id;
};

Token token_of(std::string_view text) {
    const std::size_t mark = text.rfind('#');
    Token token{text.substr(0, mark)};
    if (mark == std::string_view::npos) return token;
    const char* const end = text.data() + text.size();
    const auto [stop, error] = std::from_chars(text.data() + mark + 1, end, token.number);
    // With a malformed number, take the whole text as a name; names hold no '#', so none matches.
    const bool is_padded = text.size() > mark + 2 && text[mark + 1] == '0';
    if (error != std::errc() || stop != end || token.number == no_id || is_padded) token = {text};
    return token;
}

/// Follows a text down the tree, one step at a time.
class Finder {
public:
    Finder(const Snapshot& scene, std::string_view text)
        : scene_(scene),
          paths_(scene.paths()),
          text_(text) {}

    Result<std::uint64_t> find() {
        if (auto there = enter(); !there) return tl::unexpected(std::move(there.error()));
        return paths_.node_count != 0 ? path_of_node() : path_of_object();
    }

    std::vector<PathRange> paths() {
        if (!enter()) return {};
        if (paths_.node_count != 0) return paths_of_node();
        const std::uint64_t count = scene_.view().objects[object_].placement_count;
        return count == 0 ? std::vector<PathRange>{} : std::vector{PathRange{path_, path_ + count}};
    }

private:
    Result<void> enter() {
        std::size_t end = 0;
        for (std::size_t first = 0; first <= text_.size(); first = end + 1) {
            end = std::min(text_.find('/', first), text_.size());
            at_ = text_.substr(0, first == 0 ? 0 : first - 1);
            const Token token = token_of(text_.substr(first, end - first));
            const bool found = paths_.node_count != 0 ? enter_node(token) : enter_instance(token);
            if (!found) return no_such(token, text_.substr(first, end - first));
        }
        return {};
    }

    bool enter_node(const Token& token) {
        // A node with several placements stands for several numbers. Only the first of them has
        // children.
        if (number_ != no_id && number_ != paths_.nodes[node_].number) return false;
        const auto [first, end] = children_of(paths_, node_);
        const auto found = find_step(node_, end - first, token, [&, at = first](std::uint32_t i) {
            return NamedStep{paths_.nodes[at + i].name, paths_.nodes[at + i].number};
        });
        if (!found) return false;
        node_ = first + *found;
        number_ = token.number;
        return true;
    }

    bool enter_instance(const Token& token) {
        const SceneView& view = scene_.view();
        const ObjectRecord& object = view.objects[object_];
        const auto step_at = [&](std::uint32_t i) {
            const std::uint32_t index = object.first_instance + i;
            return NamedStep{view.instance_infos[index].name, number_of(paths_, index)};
        };
        const auto found = find_step(object_, object.instance_count, token, step_at);
        if (!found || step_at(*found).number != token.number) return false;
        const InstanceRecord& instance = view.instances[object.first_instance + *found];
        path_ += instance.path_base;
        object_ = instance.object;
        return true;
    }

    /// As StepIndex::find() does.
    template <class StepAt>
    [[nodiscard]] std::optional<std::uint32_t> find_step(std::uint32_t parent, std::uint32_t count,
                                                         const Token& token,
                                                         const StepAt& at) const {
        const char* const names = scene_.view().names;
        if (count >= StepIndices::steps_min)
            return scene_.steps()
                .of(parent, [&] { return StepIndex(names, count, at); })
                ->find(names, token.name, token.number);
        return StepIndex(names, count, at).find(names, token.name, token.number);
    }

    [[nodiscard]] Result<std::uint64_t> path_of_node() const {
        const PathNode& node = paths_.nodes[node_];
        const std::uint32_t wanted = number_ == no_id ? 0 : number_;
        for (std::uint32_t r = node.first_run; r < paths_.run_count; ++r) {
            const PathRun& run = paths_.runs[r];
            if (run.node != node_) break;
            const std::uint64_t end = end_of_run(paths_, r, scene_.statistics().instances);
            if (wanted >= run.number && wanted - run.number < end - run.first_path)
                return run.first_path + (wanted - run.number);
        }
        const std::uint64_t placed = number_ == no_id ? 0 : end_of_numbers(node);
        if (placed != 0 && number_ >= placed)
            return refuse(fmt::format("there is no '{}': the last one is '{}#{}'", shown(text_),
                                      shown(text_.substr(0, text_.rfind('#'))), placed - 1));
        return nothing_placed();
    }

    /// Returns the number behind the last one that a placement of a node, or of one beside it with
    /// the same name, has; 0 if they place nothing themselves.
    [[nodiscard]] std::uint64_t end_of_numbers(const PathNode& node) const {
        std::uint64_t last = 0;
        const auto [first, end] = children_of(paths_, node.parent);
        for (std::uint32_t i = first; i < end; ++i) {
            if (paths_.nodes[i].name != node.name) continue;
            for (std::uint32_t r = paths_.nodes[i].first_run;
                 r < paths_.run_count && paths_.runs[r].node == i; ++r)
                last = std::max(last, paths_.runs[r].number +
                                          end_of_run(paths_, r, scene_.statistics().instances) -
                                          paths_.runs[r].first_path);
        }
        return last;
    }

    /// Its own path, and those of all nodes below it, which are neighbours on each level.
    [[nodiscard]] std::vector<PathRange> paths_of_node() const {
        std::vector<PathRange> ranges;
        if (const auto own = path_of_node()) ranges.push_back({*own, *own + 1});
        if (number_ != no_id && number_ != paths_.nodes[node_].number) return ranges;
        auto [first, end] = children_of(paths_, node_);
        while (first < end) {
            for (std::uint32_t i = first; i < end; ++i)
                for (std::uint32_t r = paths_.nodes[i].first_run;
                     r < paths_.run_count && paths_.runs[r].node == i; ++r)
                    ranges.push_back({paths_.runs[r].first_path,
                                      end_of_run(paths_, r, scene_.statistics().instances)});
            const std::uint32_t next = children_of(paths_, first).first;
            end = children_of(paths_, end - 1).second;
            first = next;
        }
        std::ranges::sort(ranges, {}, &PathRange::first);
        std::size_t kept = 0;
        for (const PathRange& range : ranges)
            if (kept != 0 && ranges[kept - 1].end == range.first)
                ranges[kept - 1].end = range.end;
            else
                ranges[kept++] = range;
        ranges.resize(kept);
        return ranges;
    }

    [[nodiscard]] Result<std::uint64_t> path_of_object() const {
        if (scene_.view().objects[object_].has_own_primitives()) return path_;
        return nothing_placed();
    }

    [[nodiscard]] tl::unexpected<Error> nothing_placed() const {
        std::string hint;
        for (const std::string& name : names_below())
            hint += fmt::format("{}{}/{}", hint.empty() ? "; below it: " : ", ", text_, name);
        return refuse(fmt::format("'{}' places nothing that can be hit{}", shown(text_), hint));
    }

    [[nodiscard]] tl::unexpected<Error> no_such(const Token& token, std::string_view step) const {
        const std::string where = at_.empty() ? "the scene" : fmt::format("'{}'", shown(at_));
        if (token.number == no_id && is_repeated(token.name)) {
            const char* const slash = at_.empty() ? "" : "/";
            return refuse(fmt::format("{} has several '{}': give the number, as '{}{}{}#0'", where,
                                      shown(step), shown(at_), slash, shown(step)));
        }
        std::string hint;
        for (const std::string& below : names_below())
            hint += fmt::format("{}{}", hint.empty() ? "; there are: " : ", ", below);
        if (hint.find("%2F") != std::string::npos) hint += "; %2F is a / inside a name";
        return refuse(fmt::format("{} has no '{}'{}", where, shown(step), hint));
    }

    [[nodiscard]] bool is_repeated(std::string_view name) const {
        bool repeated = false;
        each_below([&](std::uint32_t other, std::uint32_t number) {
            repeated = scene_.view().names + other == name && number != no_id;
            return !repeated;
        });
        return repeated;
    }

    /// Returns the first few possible next steps.
    [[nodiscard]] std::vector<std::string> names_below() const {
        constexpr std::size_t few = 5;
        std::vector<std::string> names;
        each_below([&](std::uint32_t name, std::uint32_t number) {
            names.push_back(names.size() == few ? "..."
                                                : numbered(scene_.view().names + name, number));
            return names.size() <= few;
        });
        return names;
    }

    /// Calls visit(name, number) for each step below this one until visit returns false.
    template <class Visit>
    void each_below(Visit&& visit) const {
        if (paths_.node_count != 0) {
            const auto [first, end] = children_of(paths_, node_);
            for (std::uint32_t i = first; i < end; ++i)
                if (!visit(paths_.nodes[i].name, paths_.nodes[i].number)) return;
            return;
        }
        const SceneView& view = scene_.view();
        const ObjectRecord& object = view.objects[object_];
        for (std::uint32_t i = 0; i < object.instance_count; ++i) {
            const std::uint32_t index = object.first_instance + i;
            if (!visit(view.instance_infos[index].name, number_of(paths_, index))) return;
        }
    }

    [[nodiscard]] static std::string shown(std::string_view text) {
        constexpr std::size_t most = 200;
        return fmt::format("{}{}", text.substr(0, most), text.size() > most ? "..." : "");
    }

    [[nodiscard]] static tl::unexpected<Error> refuse(std::string why) {
        return fail(ErrorCode::scene_invalid, std::move(why));
    }

    const Snapshot& scene_;
    const PathTable& paths_;
    const std::string_view text_;
    std::string_view at_;                        ///< the path id of the steps so far
    std::uint32_t node_ = 0;                     ///< in a scene with nodes
    std::uint32_t number_ = no_id;               ///< number of the last step
    std::uint32_t object_ = scene_.view().root;  ///< in a scene without nodes
    std::uint64_t path_ = 0;
};

}  // namespace

Result<std::vector<PathStep>> expand_path(const Snapshot& scene, std::uint64_t path) {
    const std::uint64_t paths = scene.statistics().instances;
    if (path >= paths) {
        return fail(ErrorCode::scene_invalid, "the scene has no path " + std::to_string(path) +
                                                  ": it has " + std::to_string(paths) +
                                                  ", counted from 0");
    }
    auto steps =
        scene.paths().node_count != 0 ? expand_nodes(scene, path) : expand_instances(scene, path);
    shorten(steps);
    return steps;
}

std::string path_name(const std::vector<PathStep>& steps) {
    std::string name;
    for (const PathStep& step : steps) {
        if (!name.empty()) name += '/';
        name += step.name;
    }
    return name;
}

Result<std::uint64_t> find_path(const Snapshot& scene, std::string_view text) {
    return Finder(scene, text).find();
}

std::vector<PathRange> named_paths(const Snapshot& scene, std::string_view text) {
    const bool has_empty_step =
        text.empty() || text.front() == '/' || text.back() == '/' || text.find("//") != text.npos;
    if (has_empty_step) return {};
    return Finder(scene, text).paths();
}

std::uint64_t end_of_run(const PathTable& paths, std::uint32_t run, std::uint64_t path_count) {
    return run + 1 < paths.run_count ? paths.runs[run + 1].first_path : path_count;
}

std::string path_step_text(std::string_view name) {
    const bool digits = std::all_of(name.begin(), name.end(), is_digit);
    std::string text;
    for (std::size_t i = 0; i < name.size(); ++i) {
        const char c = name[i];
        const bool escaped = c == '/' || c == '#' || c == '%' || c == '*' || (digits && i == 0);
        // Cut between characters: a byte 10xxxxxx continues the character before it.
        const bool starts = (static_cast<unsigned char>(c) & 0xC0U) != 0x80U;
        const auto lead = static_cast<unsigned char>(c);
        const std::size_t bytes = escaped       ? 3
                                  : lead < 0x80 ? 1
                                  : lead < 0xE0 ? 2
                                  : lead < 0xF0 ? 3
                                                : 4;
        if (starts && text.size() + bytes > path_step_bytes_max) break;
        if (!escaped) {
            text += c;
            continue;
        }
        constexpr const char* hex = "0123456789ABCDEF";
        const auto byte = static_cast<unsigned char>(c);
        ((text += '%') += hex[byte >> 4U]) += hex[byte & 15U];
    }
    return text;
}

std::string numbered(std::string_view step, std::uint32_t number) {
    std::string text(step);
    if (number != no_id) (text += '#') += std::to_string(number);
    return text;
}

}  // namespace raynest
