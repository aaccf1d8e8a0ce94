#include "engine/scene/lists/step_index.h"

#include "engine/geometry/hit.h"

#include <algorithm>
#include <tuple>

namespace raynest {
namespace {

std::uint32_t hash_of(std::string_view name) {
    return static_cast<std::uint32_t>(std::hash<std::string_view>()(name));
}

/// By what runs are sorted.
constexpr auto order = [](const auto& run) { return std::tuple(run.hash, run.name, run.number); };

}  // namespace

StepIndex::StepIndex(const char* names, std::uint32_t count, const StepAt& at) {
    for (std::uint32_t i = 0; i < count; ++i) {
        const NamedStep step = at(i);
        if (!runs_.empty()) {
            Run& last = runs_.back();
            if (last.name == step.name && last.number != no_id &&
                step.number == last.number + last.count) {
                ++last.count;
                continue;
            }
        }
        runs_.push_back({hash_of(names + step.name), step.name, step.number, i, 1});
    }
    std::ranges::sort(runs_, {}, order);
    runs_.shrink_to_fit();
}

std::optional<std::uint32_t> StepIndex::find(const char* names, std::string_view name,
                                             std::uint32_t number) const {
    const std::uint32_t hash = hash_of(name);
    auto first = std::ranges::lower_bound(runs_, hash, {}, &Run::hash);
    // Several names may have this hash.
    while (first != runs_.end() && first->hash == hash) {
        const auto behind = [&](std::uint32_t last) {
            return std::ranges::upper_bound(first, runs_.end(), std::tuple(hash, first->name, last),
                                            {}, order);
        };
        if (names + first->name == name) {
            const auto next = behind(number);
            // Steps with and without a number are not the same.
            if (next == first || ((next - 1)->number == no_id) != (number == no_id))
                return std::nullopt;
            const Run& run = *(next - 1);
            return run.place + std::min(number - run.number, run.count - 1);
        }
        first = behind(no_id);
    }
    return std::nullopt;
}

}  // namespace raynest
