#include "client/requests/request_options.h"

#include "client/ground/numbers.h"

#include <algorithm>
#include <charconv>
#include <limits>

namespace raynest::client {
namespace {

constexpr std::string_view instance_key = "inst=";
constexpr std::string_view object_key = "object=";
constexpr std::string_view path_key = "path=";

/// The number behind a key; nothing if the text has another key or no number.
template <class Number>
std::optional<Number> number_of(std::string_view text, std::string_view key) {
    if (!text.starts_with(key)) return std::nullopt;
    text.remove_prefix(key.size());
    Number number = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
    if (error != std::errc{} || end != text.data() + text.size()) return std::nullopt;
    return number;
}

}  // namespace

Result<WorldRay> parse_ray(const std::string& text) {
    const auto numbers = parse_world(text, 6, 8, ray_form);
    if (!numbers) return tl::unexpected<Failure>(numbers.error());
    const std::vector<double>& n = *numbers;
    if (n.size() == 6)
        return WorldRay{n[0], n[1], n[2], 0,
                        n[3], n[4], n[5], std::numeric_limits<double>::infinity()};
    // Such rays hit nothing: they are of those who write tmin and tmax last.
    const bool is_range = n[3] >= 0 && n[3] <= n[7];
    if (!is_range || (n[4] == 0 && n[5] == 0 && n[6] == 0))
        return fail(
            Exit::usage,
            "'" + text +
                "': its tmin, the fourth of eight numbers, must be from 0 to tmax, "
                "the eighth, and its direction between them not zero: they are ox,oy,oz,tmin,"
                "dx,dy,dz,tmax");
    return WorldRay{n[0], n[1], n[2], n[3], n[4], n[5], n[6], n[7]};
}

Result<void> check_selection(const std::string& text) {
    if (text.empty()) return fail(Exit::usage, "names nothing");
    const bool is_numbered = number_of<std::uint32_t>(text, instance_key) ||
                             number_of<std::uint32_t>(text, object_key) ||
                             number_of<std::uint64_t>(text, path_key);
    if (!is_numbered && (text.starts_with(instance_key) || text.starts_with(object_key) ||
                         text.starts_with(path_key)))
        return fail(Exit::usage, "'" + text + "' has no whole number behind its '='");
    return {};
}

void add_selection(const JobOptions& options, wire::JobT& job) {
    const auto add = [](const std::vector<std::string>& selected, auto& instances, auto& objects,
                        auto& ids, auto& texts) {
        for (const std::string& text : selected) {
            if (const auto instance = number_of<std::uint32_t>(text, instance_key))
                instances.push_back(*instance);
            else if (const auto object = number_of<std::uint32_t>(text, object_key))
                objects.push_back(*object);
            else if (const auto path = number_of<std::uint64_t>(text, path_key))
                ids.push_back(*path);
            else
                texts.push_back(text);
        }
    };
    add(options.hide, job.hidden_instances, job.hidden_objects, job.hidden_path_ids,
        job.hidden_paths);
    add(options.only, job.only_instances, job.only_objects, job.only_path_ids, job.only_paths);
    job.skip_hidden_boxes = options.skip_hidden_boxes;
}

Result<PartRange> part_of(const PartOption& part, std::uint64_t all, std::uint64_t step,
                          const char* items) {
    if (part.count == 0) return PartRange{0, all};
    const std::uint64_t steps = (all + step - 1) / step;
    if (part.count > steps)
        return fail(Exit::usage, "--part: " + std::to_string(all) + " " + items + " have at most " +
                                     std::to_string(steps) + " parts");
    // Both below 2^36: no product wraps.
    const auto begin = [&](std::uint64_t number) {
        return std::min(all, steps * number / part.count * step);
    };
    const std::uint64_t first = begin(part.number - 1);
    return PartRange{first, begin(part.number) - first};
}

}  // namespace raynest::client
