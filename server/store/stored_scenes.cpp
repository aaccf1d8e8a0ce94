// SceneStore: what is stored, and which scenes are in memory.
#include "server/store/scene_store.h"

#include <algorithm>
#include <ctime>

namespace raynest::server {

StoredScene SceneStore::Entry::row() const {
    return {.owner = owner,
            .name = scene.name,
            .share = {share.begin(), share.end()},
            .digest = facts.digest,
            .epoch = scene.epoch,
            .bytes = facts.bytes,
            .instanced_triangles = facts.instanced_triangles,
            .build_seconds = scene.build_seconds,
            .used = std::time(nullptr)};
}

Reply<void> SceneStore::check_publication(const std::string& name, const Snapshot& snapshot,
                                          const Publication& how,
                                          const ConnectionId& caller) const {
    if (const auto quota = check_quota(name, caller, snapshot.bytes().size()); !quota) return quota;
    const Entry* const taken = own_entry(name, caller);
    if (taken != nullptr && taken->facts.digest != snapshot.digest() && !how.replace &&
        taken->damage.empty())
        return refuse(Code::name_taken, "another scene is called '" + name +
                                            "'; give this one another `name`, or put it in the "
                                            "other's place with `replace`");
    return {};
}

Reply<SceneStore::Stored> SceneStore::prepare_to_store(const std::string& name,
                                                       std::shared_ptr<const Snapshot> snapshot,
                                                       const Publication& how,
                                                       const ConnectionId& caller) {
    if (const auto allowed = check_publication(name, *snapshot, how, caller); !allowed)
        return tl::unexpected(allowed.error());
    const Entry* const taken = own_entry(name, caller);
    const SceneFacts facts = facts_of(*snapshot);
    if (const auto fits = room_for(taken, caller.principal).check(facts.bytes); !fits)
        return tl::unexpected(fits.error());
    Stored stored;
    stored.claim = claims_.take(caller.principal, facts.bytes);
    if (taken != nullptr) stored.row = taken->row();
    if (taken != nullptr && taken->stored.number != 0)
        stored.before = std::make_unique<StoredScene>(taken->stored);
    const bool equal = taken != nullptr && taken->facts.digest == facts.digest;
    stored.row.owner = caller.principal;
    stored.row.name = name;
    if (!equal) stored.row.epoch = taken == nullptr ? 1 : taken->next_epoch();
    if (!how.share.empty()) stored.row.share = how.share;
    stored.row.digest = facts.digest;
    stored.row.bytes = facts.bytes;
    stored.row.instanced_triangles = facts.instanced_triangles;
    stored.row.build_seconds = snapshot->statistics().build_seconds;
    stored.row.used = std::time(nullptr);
    auto held = hold(std::move(snapshot), caller.principal);
    if (!held) return tl::unexpected(held.error());
    stored.held = std::move(*held);
    return stored;
}

std::uint64_t SceneStore::on_disk_of(const std::string& principal) const {
    std::uint64_t bytes = 0;
    for (const auto& [name, entry] : entries_)
        if (entry.owner == principal) bytes += entry.disk_bytes();
    return bytes;
}

DiskRoom SceneStore::room_for(const Entry* changed, const std::string& owner) const {
    const std::uint64_t bytes_max = quotas_.of(owner).disk_bytes;
    const std::uint64_t others =
        on_disk_of(owner) -
        (changed != nullptr && changed->owner == owner ? changed->disk_bytes() : 0) +
        claims_.of(owner);
    return {bytes_max - std::min(bytes_max, others), owner,
            quotas_.limit_text(owner, &Quota::disk_bytes) + "; " +
                remedy(owner, quotas_.remedy(owner, &Quota::disk_bytes))};
}

DiskRoom SceneStore::disk_room(std::string_view name, const ConnectionId& caller) const {
    return room_for(own_entry(name, caller), caller.principal);
}

bool SceneStore::is_stored(std::string_view name, const ConnectionId& caller) const {
    const Entry* const taken = own_entry(name, caller);
    return taken != nullptr && taken->kept;
}

bool SceneStore::is_from_before(std::string_view name, const ConnectionId& caller) const {
    const Entry* const taken = own_entry(name, caller);
    return taken != nullptr && taken->from_before;
}

void SceneStore::adopt(StateFolder& state) {
    for (std::size_t i = 0; i < state.found().size(); ++i) {
        const StoredScene& row = state.found()[i];
        const KeptEdits& edits = state.found_edits()[i];
        Entry entry;
        entry.scene.name = row.name;
        entry.scene.epoch = row.epoch;
        entry.scene.build_seconds = row.build_seconds;
        entry.facts = {row.digest, row.bytes, row.instanced_triangles};
        entry.blob = state.pin(row.digest);
        entry.stored = row;
        entry.edits = edits.count;
        entry.edit_bytes = edits.bytes;
        entry.epoch_reserved = std::max(row.epoch, edits.epoch_last);
        entry.epoch_free = entry.epoch_reserved + 1;
        if (edits.count != 0) {
            entry.scene.epoch = edits.last.epoch;
            entry.facts = {edits.last.digest, edits.last.bytes, edits.last.instanced_triangles};
        }
        entry.from_before = true;
        entry.owner = row.owner;
        entry.share = {row.share.begin(), row.share.end()};
        entry.kept = true;
        entry.loaded = entry.used = now_();
        entries_.emplace(row.name, std::move(entry));
    }
}

protocol::Error SceneStore::asleep(const Entry& entry) const {
    if (!entry.damage.empty())
        return {Code::scene_invalid,
                "the stored copy of scene '" + entry.scene.name + "' is damaged: " + entry.damage +
                    "; `Load` it again, or `Unload` it",
                0};
    StoredScene row = entry.stored;
    // Its name was unloaded while it was on the disk alone: connections hold its blob.
    if (row.number == 0) row.digest = entry.facts.digest, row.bytes = entry.facts.bytes;
    asleep_ = AsleepScene{entry.facts, entry.owner, std::move(row)};
    return {Code::busy, "scene '" + entry.scene.name + "' is read from the disk; ask again", 0};
}

std::optional<AsleepScene> SceneStore::take_asleep() {
    return std::exchange(asleep_, std::nullopt);
}

Reply<void> SceneStore::wake(std::shared_ptr<const Snapshot> snapshot, const AsleepScene& scene) {
    std::erase_if(by_digest_, [](const auto& known) { return known.second.expired(); });
    auto held = hold(std::move(snapshot), scene.owner);
    if (!held) return tl::unexpected(held.error());
    for (auto& [name, entry] : entries_) {
        if (entry.facts.digest != scene.facts.digest || entry.scene.held) continue;
        entry.scene.held = *held;
        entry.damage.clear();
        if (entry.stored.number == 0) entry.blob.reset();
    }
    settle_charge(**held);
    return {};
}

std::vector<std::string> SceneStore::quarantine(const std::string& digest, const std::string& why) {
    std::vector<std::string> names;
    for (auto& [name, entry] : entries_) {
        if (entry.facts.digest != digest || entry.scene.held) continue;
        entry.damage = why;
        names.push_back(entry.owner + "/" + name);
    }
    return names;
}

void SceneStore::make_room(std::uint64_t bytes, const std::string& principal) {
    const std::uint64_t bytes_max = quotas_.of(principal).scene_bytes;
    const auto beyond_quota = [&] {
        const std::uint64_t held =
            charged_to(principal, true).bytes + charged_to(principal, false).bytes;
        return bytes <= bytes_max && held > bytes_max - bytes;
    };
    const auto beyond_budget = [&] { return budget_.room(principal, Use::lasting) < bytes; };
    // The principal's own scenes first: others' do not help it beyond its quota.
    while (beyond_quota() && let_go_of_oldest(&principal)) {
    }
    while (beyond_budget() && let_go_of_oldest(nullptr)) {
    }
}

bool SceneStore::let_go_of_oldest(const std::string* principal) {
    struct Candidate {
        Clock::time_point used;
        long references = 0;  ///< by entries that may let go of the memory
        bool charged = false;
    };
    std::map<const HeldScene*, Candidate> candidates;
    for (const auto& [name, entry] : entries_) {
        if (entry.scene.held == nullptr || entry.blob == nullptr || entry.pinned) continue;
        Candidate& candidate = candidates[entry.scene.held.get()];
        candidate.used = std::max(candidate.used, entry.used);
        candidate.charged |= principal == nullptr || entry.charged_to(*principal);
        ++candidate.references;
    }
    const HeldScene* oldest = nullptr;
    for (const auto& [name, entry] : entries_) {
        const auto found = candidates.find(entry.scene.held.get());
        // Jobs, other names, and edits that may take the memory refer to it, too.
        if (found == candidates.end() || !found->second.charged ||
            found->second.references != entry.scene.held.use_count())
            continue;
        if (oldest == nullptr || found->second.used < candidates.at(oldest).used)
            oldest = found->first;
    }
    if (oldest == nullptr) return false;
    for (auto& [name, entry] : entries_)
        if (entry.scene.held.get() == oldest) entry.scene.held.reset();
    return true;
}

SceneStore::Total SceneStore::asleep() const {
    Total total;
    for (const auto& [name, entry] : entries_) {
        if (entry.scene.held) continue;
        ++total.scenes;
        total.bytes += entry.facts.bytes;
    }
    return total;
}

std::uint64_t SceneStore::bytes() const {
    std::uint64_t sum = 0;
    for (const auto& [digest, held] : by_digest_)
        if (const auto scene = held.lock()) sum += scene->snapshot->bytes().size();
    return sum;
}

SceneStore::Total SceneStore::charged_to(const std::string& principal, bool listed) const {
    Total total;
    for (const auto& [name, entry] : entries_) {
        if (entry.listed != listed || !entry.charged_to(principal)) continue;
        ++total.scenes;
        if (entry.scene.held) total.bytes += entry.facts.bytes;
    }
    return total;
}

SceneStore::Total SceneStore::unlisted() const {
    Total total;
    for (const auto& [name, entry] : entries_) {
        if (entry.listed) continue;
        ++total.scenes;
        if (entry.scene.held) total.bytes += entry.facts.bytes;
    }
    return total;
}

}  // namespace raynest::server
