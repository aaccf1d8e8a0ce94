#include "client/requests/difference.h"

#include "client/ground/numbers.h"
#include "client/requests/scene_source.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <string_view>

namespace raynest::client {
namespace {

/// Options of a job that do not change what its counters say.
constexpr std::array<std::string_view, 4> idle_keys = {"traversal", "worker", "priority",
                                                       "deadline"};

std::string key_of(const std::string& setting) {
    return setting.substr(0, setting.find('='));
}

}  // namespace

Result<void> read_difference(const std::string& text, Difference& difference) {
    const std::size_t equals = text.find('=');
    if (equals == std::string::npos || is_source(text)) {
        if (!difference.scene.empty())
            return fail(Exit::usage, "'" + text + "' is a second scene; one is compared with");
        difference.scene = text;
        return {};
    }
    const std::string key = text.substr(0, equals);
    const std::string value = text.substr(equals + 1);
    if (key.empty() || value.empty())
        return fail(Exit::usage, "'" + text + "' is neither a scene nor KEY=VALUE");
    if (std::ranges::find(idle_keys, key) != idle_keys.end())
        return fail(Exit::usage, "'" + text +
                                     "' makes no difference: counters are those of the "
                                     "single traversal on the CPU, whichever is asked for");
    if (key == "intersector") {
        difference.intersector = value;
    } else if (key == "mask") {
        const auto mask = parse_mask(value);
        if (!mask) return tl::unexpected<Failure>(mask.error());
        difference.mask = *mask;
    } else if (key == "epoch") {
        std::uint64_t epoch = 0;
        const char* last = value.data() + value.size();
        const auto [end, error] = std::from_chars(value.data(), last, epoch);
        if (error != std::errc{} || end != last || epoch == 0)
            return fail(Exit::usage, "'" + text + "' is not an epoch, a whole number from 1 on");
        difference.epoch = epoch;
    } else {
        for (const std::string& setting : difference.settings)
            if (key_of(setting) == key) return fail(Exit::usage, "'" + key + "' is given twice");
        difference.settings.push_back(text);
    }
    return {};
}

JobOptions other_job(const JobOptions& job, const Difference& difference) {
    JobOptions other = job;
    if (!difference.scene.empty()) {
        other.scene = difference.scene;
        // Paths, and numbers of instances and objects mean others there.
        other.hide.clear();
        other.only.clear();
        other.epoch = 0;
    }
    if (difference.epoch) other.epoch = *difference.epoch;
    if (difference.mask) other.mask = *difference.mask;
    if (!difference.intersector.empty()) {
        // The parameters of one intersector are not those of another.
        if (difference.intersector != job.intersector) {
            other.settings.clear();
            other.tables.clear();
        }
        other.intersector = difference.intersector;
    }
    for (const std::string& setting : difference.settings) {
        std::erase_if(other.settings,
                      [&](const std::string& old) { return key_of(old) == key_of(setting); });
        other.settings.push_back(setting);
    }
    for (const TableOption& table : difference.tables) {
        std::erase_if(other.tables, [&](const TableOption& old) { return old.name == table.name; });
        other.tables.push_back(table);
    }
    return other;
}

}  // namespace raynest::client
