// SceneStore: edits, and what of them outlives the daemon.
#include "server/security/access.h"
#include "server/store/scene_store.h"

#include <algorithm>
#include <utility>

namespace raynest::server {
namespace {

/// Edits that are read after a blob, at most: so many are made again when the scene is next used.
constexpr std::uint64_t kept_edits_max = 1000;
/// Bytes of these: a share of the scene's, but no less and no more than so many.
constexpr std::uint64_t kept_bytes_part = 4;
constexpr std::uint64_t kept_bytes_least = 1 << 20;
constexpr std::uint64_t kept_bytes_most = 64 << 20;
/// Epochs that one commit reserves.
constexpr std::uint64_t epochs_reserved = 1000;

}  // namespace

Reply<void> SceneStore::may_keep(std::string_view name, bool has_state,
                                 const ConnectionId& caller) {
    if (!has_state)
        return refuse(Code::invalid_field,
                      "`keep` needs a daemon that stores scenes: start raynestd with --state "
                      "DIR, or leave `keep` out");
    const Entry* const entry = meant(name, caller);
    if (entry == nullptr) return tl::unexpected(not_found(name, caller));
    if (entry->stored.number == 0)
        return refuse(Code::invalid_field,
                      "scene '" + entry->scene.name +
                          "' is not stored: it is temporary, or has been unloaded. Leave `keep` "
                          "out, or `Load` it by name");
    return {};
}

Reply<EditPlan> SceneStore::plan_edit(const NamedScene& before, std::uint64_t change_bytes,
                                      bool keep, bool whole, const ConnectionId& caller) {
    const Entry* const found = meant(before.name, caller);
    if (found == nullptr || found->stored.number == 0) return EditPlan{};
    const Entry& entry = *found;
    EditPlan plan{.row = entry.stored};
    if (entry.next_epoch() > entry.epoch_reserved)
        plan.reserve = entry.next_epoch() + epochs_reserved;
    plan.whole = whole || entry.blob == nullptr || entry.edits >= kept_edits_max ||
                 entry.edit_bytes + change_bytes > std::clamp(entry.facts.bytes / kept_bytes_part,
                                                              kept_bytes_least, kept_bytes_most);
    if (!keep) return plan;
    plan.room = room_for(&entry, entry.owner);
    if (!plan.whole)
        if (const auto fits =
                plan.room.check(plan.room.needed_for(entry.stored.digest, entry.stored.bytes) +
                                entry.edit_bytes + change_bytes);
            !fits)
            return tl::unexpected(fits.error());
    return plan;
}

Reply<std::optional<NamedScene>> SceneStore::publish_edit(const NamedScene& before,
                                                          std::shared_ptr<const Snapshot> edited,
                                                          const ConnectionId& caller,
                                                          EditPublication how) {
    forget_freed();
    if (const auto allowed = may_edit(before.name, caller); !allowed)
        return tl::unexpected(allowed.error());
    Entry& entry = *meant(before.name, caller);
    if (entry.scene.epoch != before.epoch || entry.scene.held != before.held ||
        entry.stored.number != how.plan.row.number)
        return std::optional<NamedScene>();
    // An edit that was to follow this one on the disk has failed meanwhile.
    if (how.keep && !how.blob && !entry.blob) return std::optional<NamedScene>();
    if (const std::uint64_t bytes = edited->bytes().size(); bytes > entry.facts.bytes)
        if (const auto quota = check_quota(&entry, entry.owner, bytes); !quota)
            return tl::unexpected(quota.error());
    auto held = hold(std::move(edited), entry.is_owners() ? entry.owner : caller.principal);
    if (!held) return tl::unexpected(held.error());
    entry.unsettle();
    const auto replaced = std::exchange(entry.scene.held, std::move(*held));
    entry.unsettle();
    entry.facts = facts_of(entry.scene.snapshot());
    entry.lower_holds();
    std::erase_if(entry.earlier, [](const auto& epoch) { return epoch.second.expired(); });
    entry.earlier.emplace(before.epoch, replaced);
    entry.epoch_reserved = std::max(entry.epoch_reserved, how.plan.reserve);
    entry.scene.epoch = entry.next_epoch();
    entry.scene.last_edit = std::move(how.summary);
    if (how.blob) entry.facts.arena = *how.blob;
    if (!how.keep || how.blob) entry.blob = std::move(how.blob);
    if (how.keep) {
        KeptEdit& edit = how.keep->edit;
        if (how.number != 0) {
            how.keep->ended = entry.stored.number;
            entry.stored = entry.row();
            entry.stored.number = how.number;
            entry.edits = entry.edit_bytes = 0;
            how.keep->row = std::make_unique<StoredScene>(entry.stored);
            edit = {.number = how.number,
                    .epoch = std::max(entry.epoch_reserved, entry.scene.epoch)};
        } else {
            edit.number = entry.stored.number;
            edit.epoch = entry.scene.epoch;
            edit.before = before.epoch;
            edit.digest = entry.facts.digest;
            edit.bytes = entry.facts.bytes;
            edit.instanced_triangles = entry.facts.instanced_triangles;
            ++entry.edits;
            entry.edit_bytes += edit.change.size();
        }
    }
    entry.used = entry.loaded = now_();
    entry.made_of.clear();
    settle_charges();
    entry.spare = replaced;
    return std::optional(entry.scene_for(caller));
}

Reply<NamedScene> SceneStore::find_to_read(std::string_view name, std::uint64_t epoch,
                                           const ConnectionId& caller) {
    const Entry* const entry = meant(name, caller);
    if (entry == nullptr || !entry->earlier.contains(epoch)) return find(name, epoch, caller);
    auto held = entry->earlier.at(epoch).lock();
    if (held == nullptr) return find(name, epoch, caller);
    entry->used = now_();
    NamedScene scene = entry->scene_for(caller);
    scene.epoch = epoch;
    scene.kept = false;
    scene.last_edit.clear();
    scene.held = std::move(held);
    return read_by(std::move(scene), caller.principal);
}

Reply<std::string> SceneStore::pin(std::string_view name, bool pinned, const ConnectionId& caller) {
    if (const auto allowed = may_edit(name, caller); !allowed)
        return tl::unexpected(allowed.error());
    // To let go of one that is on the disk needs no memory.
    if (pinned)
        if (const auto scene = find(name, 0, caller); !scene) return tl::unexpected(scene.error());
    Entry& entry = *meant(name, caller);
    entry.pinned = pinned;
    entry.used = now_();
    return entry.name_for(caller);
}

void SceneStore::edit_was_not_kept(std::uint64_t number) {
    for (auto& [name, entry] : entries_)
        if (entry.stored.number == number) entry.blob.reset();
}

}  // namespace raynest::server
