#include "engine/scene/edits/names.h"

#include "engine/scene/edits/covered.h"
#include "engine/scene/named_paths.h"

#include <fmt/format.h>

#include <algorithm>
#include <optional>

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

/// Returns the steps that two paths have in common, as a text. All paths between them have these
/// too.
std::string common_text(std::vector<PathStep> first, const std::vector<PathStep>& last) {
    std::size_t count = 0;
    while (count < first.size() && count < last.size() && first[count].name == last[count].name)
        ++count;
    first.resize(count);
    return path_name(first);
}

/// Finds the outer ones of the instances all of whose placements match, and objects of which only
/// the own primitives do. `text_of` returns the text of an outermost instance, as text_above() does.
/// `steps`: not 0 for instances that match themselves, as InstanceFinder::find() wants them.
class Search {
public:
    using TextOf = std::function<const std::string&(std::uint32_t)>;

    Search(const Snapshot& scene, TextOf text_of, std::string_view glob, std::size_t steps,
           const std::function<bool()>& stopped, std::uint64_t& looked_at, std::size_t nested_max)
        : looked_at_(looked_at),
          nested_max_(nested_max),
          steps_(steps),
          scene_(scene),
          text_of_(std::move(text_of)),
          glob_(glob),
          beginning_(glob.substr(0, glob.find('*'))),
          stopped_(stopped) {}

    Result<NamedParts> search() {
        const SceneView& view = scene_.view();
        const ObjectRecord& root = view.objects[view.root];
        if (root.has_own_primitives() && glob_matches(glob_, text_above(scene_, 0, 1)))
            found_.own.emplace_back();
        for (std::uint32_t i = 0; i < root.instance_count; ++i) {
            // The longest texts take 30 ms to compare.
            if (stopped_()) return stopped();
            const InstanceRecord& instance = view.instances[root.first_instance + i];
            const std::uint64_t placements = view.objects[instance.object].placement_count;
            if (placements == 0) continue;  // it has no path
            const std::string& common = text_of_(i);
            if (!common.empty() && glob_matches(glob_, common)) {
                way_.assign(1, i);
                add(instance.object);
                way_.clear();
                continue;
            }
            const std::size_t both = std::min(common.size(), beginning_.size());
            if (placements == 1 || common.compare(0, both, beginning_, 0, both) != 0) continue;
            if (auto looked = look_into(i, instance, placements); !looked)
                return tl::unexpected(looked.error());
        }
        return std::move(found_);
    }

private:
    static tl::unexpected<Error> stopped() { return fail(ErrorCode::limit_exceeded, "stopped"); }

    Result<void> look_into(std::uint32_t place, const InstanceRecord& instance,
                           std::uint64_t placements) {
        looked_at_ += placements;
        if (looked_at_ > nested_placements_max)
            return fail(ErrorCode::limit_exceeded,
                        fmt::format("the texts, '{}' at last, may stand for parts of more than {} "
                                    "placements: begin it with the "
                                    "text of an outermost instance",
                                    glob_, nested_placements_max));
        first_ = instance.path_base;
        matches_.assign(placements, false);
        for (std::uint64_t k = 0; k < placements; ++k) {
            if (k % 1024 == 0 && stopped_()) return stopped();
            const auto steps = expand_path(scene_, instance.path_base + k);
            matches_[k] = steps && glob_matches(glob_, path_name(*steps));
        }
        enter(instance.object, 0, place);
        if (nested_ <= nested_max_) return {};
        return fail(ErrorCode::limit_exceeded,
                    fmt::format("'{}' stands for more than {} parts of instances: name what stands "
                                "above them",
                                glob_, nested_max_));
    }

    /// Looks at an instance at a place of the object above, whose first placement is `base` of the
    /// outermost one's.
    void enter(std::uint32_t object, std::uint64_t base, std::uint32_t place) {
        const SceneView& view = scene_.view();
        const ObjectRecord& record = view.objects[object];
        const auto first = matches_.begin() + static_cast<std::ptrdiff_t>(base);
        const auto end = first + static_cast<std::ptrdiff_t>(record.placement_count);
        if (nested_ > nested_max_ || std::find(first, end, true) == end) return;
        way_.push_back(place);
        if (std::find(first, end, false) == end &&
            (steps_ == 0 ||
             glob_matches(glob_, text_above(scene_, first_ + base, record.placement_count)))) {
            add(object);
            ++nested_;
        } else {
            if (record.has_own_primitives() && *first) {
                found_.own.push_back(way_);
                ++nested_;
            }
            for (std::uint32_t i = 0; i < record.instance_count; ++i) {
                const InstanceRecord& child = view.instances[record.first_instance + i];
                enter(child.object, base + child.path_base, i);
            }
        }
        way_.pop_back();
    }

    /// Adds the instance at the end of the way, which places this object.
    void add(std::uint32_t object) {
        const std::size_t depth = way_.size();
        go_to_step(scene_.view(), object, steps_, way_);
        found_.instances.emplace_back(way_.front(), std::vector(way_.begin() + 1, way_.end()));
        way_.resize(depth);
    }

    std::uint64_t& looked_at_;
    const std::size_t nested_max_;
    const std::size_t steps_;
    std::size_t nested_ = 0;  ///< found ones that are not outermost instances
    const Snapshot& scene_;
    const TextOf text_of_;
    const std::string_view glob_;
    const std::string_view beginning_;  ///< the glob's, before its first star
    const std::function<bool()>& stopped_;
    std::uint64_t first_ = 0;    ///< the first path of an outermost instance
    std::vector<bool> matches_;  ///< its placements
    std::vector<std::uint32_t> way_;
    NamedParts found_;
};

/// Finds what has the text, or has it above it, by the ways that the text tells; nothing where that
/// takes a look at the texts of others, too: some of it is primitives of an object's own, or it is
/// no whole text.
std::optional<NamedParts> find_whole(const Snapshot& scene, std::string_view text,
                                     std::size_t steps, std::size_t nested_max) {
    NamedParts parts;
    CoveredInstances covered(scene, nested_max);
    std::uint64_t placements = 0;
    for (const PathRange& range : named_paths(scene, text)) {
        if (!covered.find(range, steps, parts.instances)) return std::nullopt;
        placements += range.end - range.first;
    }
    if (placements == 0 || covered.placements() != placements) return std::nullopt;
    return parts;
}

}  // namespace

std::string text_above(const Snapshot& scene, std::uint64_t path, std::uint64_t count) {
    const auto first = expand_path(scene, path);
    const auto last = count == 1 ? first : expand_path(scene, path + count - 1);
    return first && last ? common_text(*first, *last) : "";
}

bool glob_matches(std::string_view glob, std::string_view text) {
    return matches_whole(glob, text) || matches_whole(std::string(glob) + "/*", text);
}

const std::string& InstanceFinder::text_of(std::uint32_t place) {
    if (place < texts_.size()) return texts_[place];
    const SceneView& view = scene_.view();
    const InstanceRecord& instance = view.instances[view.objects[view.root].first_instance + place];
    const std::uint64_t count = view.objects[instance.object].placement_count;
    text_ = count == 0 ? "" : text_above(scene_, instance.path_base, count);
    return text_;
}

Result<NamedParts> InstanceFinder::find_parts(std::string_view glob, std::size_t nested_max) {
    return search(glob, nested_max, false);
}

Result<NamedParts> InstanceFinder::search(std::string_view glob, std::size_t nested_max,
                                          bool by_steps) {
    const SceneView& view = scene_.view();
    const std::size_t steps = by_steps ? steps_of(glob) : 0;
    if (glob.find('*') == std::string_view::npos)
        if (auto parts = find_whole(scene_, glob, steps, nested_max)) return std::move(*parts);
    const ObjectRecord& root = view.objects[view.root];
    if (texts_.empty()) {
        const std::uint64_t most = bytes_per_instance * root.instance_count;
        std::uint64_t bytes = 0;
        texts_.reserve(root.instance_count);
        for (std::uint32_t i = 0; i < root.instance_count; ++i) {
            if (i % 256 == 0 && stopped_()) return fail(ErrorCode::limit_exceeded, "stopped");
            std::string text = text_of(i);
            bytes += sizeof text + text.capacity();
            if (bytes > most) break;
            texts_.push_back(std::move(text));
        }
    }
    auto found = Search(
                     scene_, [this](std::uint32_t i) -> const std::string& { return text_of(i); },
                     glob, steps, stopped_, looked_at_, nested_max)
                     .search();
    if (!found || !found->instances.empty() || !found->own.empty()) return found;
    if (glob.find('*') != std::string_view::npos)
        return fail(ErrorCode::field_invalid, fmt::format("no path is of the form '{}'", glob));
    const auto known = find_path(scene_, glob);
    // A path with this text has been found by it, unless its text was cut.
    return fail(ErrorCode::field_invalid,
                known ? fmt::format("no path has the text '{}'", glob) : known.error().message);
}

Result<std::vector<InstancePlace>> InstanceFinder::find(std::string_view glob) {
    auto found = search(glob, nested_placements_max, true);
    if (!found) return tl::unexpected(std::move(found.error()));
    if (!found->instances.empty()) return std::move(found->instances);
    return fail(ErrorCode::field_invalid,
                fmt::format("'{}' are primitives of an object's own, which has no instance to "
                            "edit there: name what stands above it",
                            glob));
}

}  // namespace raynest
