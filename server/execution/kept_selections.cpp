#include "server/execution/kept_selections.h"

#include "server/scheduling/disposal.h"

#include <algorithm>
#include <utility>

namespace raynest::server {

std::shared_ptr<Selected> KeptSelections::find(const std::string& principal,
                                               const std::shared_ptr<const HeldScene>& scene,
                                               const SelectionWords& words) {
    const auto list = kept_.find(principal);
    if (list == kept_.end()) return nullptr;
    const auto known = std::ranges::find_if(list->second, [&](const Kept& kept) {
        return kept.scene.lock() == scene && kept.selected->words() == words;
    });
    if (known == list->second.end()) return nullptr;
    if (known->selected->has_failed()) {
        drop(principal, list->second, known);
        return nullptr;
    }
    known->used = Clock::now();
    list->second.splice(list->second.begin(), list->second, known);
    return known->selected;
}

void KeptSelections::keep(const std::string& principal,
                          const std::shared_ptr<const HeldScene>& scene,
                          std::shared_ptr<Selected> selected) {
    List& list = kept_[principal];
    list.push_front({scene, std::move(selected)});
    while (list.size() > kept_max) drop(principal, list, std::prev(list.end()));
}

void KeptSelections::drop(const std::string& principal) {
    const auto list = kept_.find(principal);
    if (list == kept_.end()) return;
    for (auto kept = list->second.begin(); kept != list->second.end();)
        kept =
            kept->selected.use_count() == 1 ? drop(principal, list->second, kept) : std::next(kept);
}

void KeptSelections::drop_idle() {
    const auto now = Clock::now();
    for (auto list = kept_.begin(); list != kept_.end();) {
        for (auto kept = list->second.begin(); kept != list->second.end();)
            kept = now - kept->used > kept_time || kept->scene.expired()
                       ? drop(list->first, list->second, kept)
                       : std::next(kept);
        list = list->second.empty() ? kept_.erase(list) : std::next(list);
    }
}

std::uint64_t KeptSelections::held_by(const std::string& principal) const {
    std::uint64_t bytes = 0;
    if (const auto list = kept_.find(principal); list != kept_.end())
        for (const Kept& kept : list->second)
            if (kept.selected.use_count() == 1) bytes += kept.selected->bytes();
    return bytes;
}

KeptSelections::List::iterator KeptSelections::drop(const std::string& principal, List& list,
                                                    List::iterator kept) {
    if (kept->selected->bytes() >= disposed_bytes_min)
        dispose(pool_, principal, std::move(kept->selected));
    return list.erase(kept);
}

}  // namespace raynest::server
