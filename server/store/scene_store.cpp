#include "server/store/scene_store.h"

#include "protocol/text.h"
#include "server/security/access.h"

#include <new>
#include <ranges>
#include <utility>

namespace raynest::server {
namespace {

/// Maximum number of scenes that an error message proposes to unload.
constexpr std::size_t proposals_max = 3;

std::string counted(std::size_t count, const char* thing) {
    return std::to_string(count) + " " + thing + (count == 1 ? "" : "s");
}

/// The one error for a name that the caller cannot use, whatever the reason.
protocol::Error unknown(std::string_view name) {
    if (name.find_first_of(":.") != std::string_view::npos)
        return {Code::scene_unknown,
                "no scene is called '" + std::string(name) +
                    "'; if that is a source, `Load` it first and ask by the scene's name",
                0};
    return {Code::scene_unknown,
            "scene '" + std::string(name) + "' is not loaded; see `Scenes`, or `Load` it", 0};
}

}  // namespace

bool SceneStore::Entry::held_by(const ConnectionId& caller) const {
    const auto found = holders.find(caller.principal);
    return found != holders.end() && found->second.contains(caller.connection);
}

bool SceneStore::Entry::temporary_of(const ConnectionId& caller) const {
    return held_by(caller) && holders.at(caller.principal).at(caller.connection).temporary;
}

bool SceneStore::Entry::visible_to(const ConnectionId& caller) const {
    return owner == caller.principal || caller.role == Role::admin || share.is_public() ||
           share.contains(caller.principal) || held_by(caller);
}

bool SceneStore::Entry::is_shown_to(const std::string& principal) const {
    return owner == principal || share.is_public() || holders.contains(principal) ||
           share.contains(principal);
}

std::string SceneStore::Entry::name_for(const ConnectionId& caller) const {
    return owner == caller.principal ? scene.name : owner + "/" + scene.name;
}

NamedScene SceneStore::Entry::scene_for(const ConnectionId& caller) const {
    NamedScene named = scene;
    named.name = name_for(caller);
    named.kept = blob != nullptr && stored.number != 0;
    return named;
}

std::size_t SceneStore::Entry::connections() const {
    std::size_t count = 0;
    for (const auto& [principal, numbers] : holders) count += numbers.size();
    return count;
}

bool SceneStore::Entry::release(const ConnectionId& caller) noexcept {
    unsettle();
    const auto found = holders.find(caller.principal);
    if (found != holders.end()) {
        found->second.erase(caller.connection);
        if (found->second.empty()) holders.erase(found);
    }
    if (!is_owners())
        for (auto holder = holders.begin(); holder != holders.end();) {
            std::erase_if(holder->second,
                          [this](const auto& known) { return known.second.bytes < facts.bytes; });
            holder = holder->second.empty() ? holders.erase(holder) : std::next(holder);
        }
    return !kept && holders.empty();
}

/// The entry that a name means, of those looked at.
template <class Place>
struct SceneStore::Choice {
    explicit Choice(Place end) : none(end) {}
    /// Looks at an entry of this name; `is_qualified`: with its owner.
    void look_at(Place at, bool is_qualified, const ConnectionId& caller) {
        const Entry& entry = at->second;
        const bool holds = entry.held_by(caller);
        if (!entry.visible_to(caller) || !(entry.listed || holds)) return;
        const bool is_own = entry.owner == caller.principal;
        const Rank rank = is_own                  ? (holds ? own_and_held : Rank::own)
                          : holds || is_qualified ? held
                                                  : shared;
        if (rank == shared) ++shared_count;
        if (rank > best || (rank == best && rank == held && holds)) {
            best = rank;
            found = at;
        }
    }
    [[nodiscard]] Place result() const { return best == shared && shared_count > 1 ? none : found; }

private:
    // The order of preference: own scenes before others', held ones before listed ones. A name
    // without owner means another's scene only if there is one of it.
    enum Rank { unknown, shared, held, own, own_and_held };
    const Place none;  ///< the end
    Place found = none;
    Rank best = unknown;
    std::size_t shared_count = 0;
};

template <class AnyEntries>
auto SceneStore::resolve(AnyEntries& entries, std::string_view name, const ConnectionId& caller) {
    Choice<decltype(entries.begin())> choice(entries.end());
    for (auto at = entries.begin(); at != entries.end(); ++at) {
        const std::string& owner = at->second.owner;
        const std::string& bare = at->first;
        const bool is_qualified = name.size() == owner.size() + 1 + bare.size() &&
                                  name.starts_with(owner) && name.ends_with(bare) &&
                                  name[owner.size()] == '/';
        if (bare == name || is_qualified) choice.look_at(at, is_qualified, caller);
    }
    return choice.result();
}

template <class AnyEntries>
auto SceneStore::own(AnyEntries& entries, std::string_view name, const ConnectionId& caller) {
    const auto [first, last] = entries.equal_range(name);
    const auto found = std::find_if(first, last, [&](const auto& entry) {
        return entry.second.listed && entry.second.owner == caller.principal;
    });
    return found == last ? entries.end() : found;
}

const SceneStore::Entry* SceneStore::own_entry(std::string_view name,
                                               const ConnectionId& caller) const {
    const auto found = own(entries_, name, caller);
    return found == entries_.end() ? nullptr : &found->second;
}

SceneStore::Entry* SceneStore::meant(std::string_view name, const ConnectionId& caller) {
    const auto found = resolve(entries_, name, caller);
    return found == entries_.end() ? nullptr : &found->second;
}

template <class Range>
SceneStore::HeldNames SceneStore::held_names(const Range& entries, const ConnectionId& caller) {
    HeldNames held;
    for (const auto& [name, entry] : entries)
        if (entry.held_by(caller)) held.emplace(name, entry.owner);
    return held;
}

bool SceneStore::found_by(const Entry& entry, const ConnectionId& caller, const HeldNames& held) {
    return entry.visible_to(caller) &&
           (entry.held_by(caller) ||
            (entry.listed && !held.contains({entry.scene.name, entry.owner})));
}

void SceneStore::disconnect(const ConnectionId& caller) noexcept {
    // Any stranger's connection ends as often as it likes.
    if (holding_.erase(caller.connection) == 0) return;
    for (auto entry = entries_.begin(); entry != entries_.end();) {
        const auto next = std::next(entry);
        if (entry->second.held_by(caller) && entry->second.release(caller)) entries_.erase(entry);
        entry = next;
    }
    settle_charges();
}

std::string SceneStore::remedy(const std::string& principal, const std::string& larger,
                               Short of) const {
    if (entries_.empty()) return larger;
    std::vector<const Entry*> candidates;
    for (const auto& [name, entry] : entries_)
        // One on the disk alone takes no memory.
        if (entry.kept && entry.owner == principal &&
            (of == Short::names_or_disk || entry.scene.held))
            candidates.push_back(&entry);
    if (candidates.empty() && of == Short::memory &&
        std::ranges::none_of(
            entries_, [&](const auto& known) { return known.second.charge(principal) != 0; }))
        return larger;
    if (candidates.empty())
        return "unload a scene, close the connections that hold scenes without a name, or " +
               larger;
    std::sort(candidates.begin(), candidates.end(),
              [](const Entry* a, const Entry* b) { return a->used < b->used; });
    candidates.resize(std::min(candidates.size(), proposals_max));
    std::string names;
    for (const Entry* candidate : candidates)
        names += (names.empty() ? "'" : ", '") + candidate->scene.name + "'";
    return "unload scenes (raynest unload NAME, or --idle 1h; least recently used: " + names +
           "), or " + larger;
}

Reply<void> SceneStore::check_quota(const Entry* changed, const std::string& principal,
                                    std::uint64_t bytes) const {
    const std::uint64_t bytes_max = quotas_.of(principal).scene_bytes;
    const Claim claimed = claims_.of(principal);
    std::uint64_t scenes = claimed.scenes;
    std::uint64_t held = claimed.scene_bytes;
    for (const auto& [name, entry] : entries_) {
        if (&entry == changed || !entry.charged_to(principal)) continue;
        ++scenes;
        held += entry.charge(principal);
    }
    if (scenes >= limits_.principal_scenes_max)
        return refuse(Code::quota, principal + " holds " + counted(scenes, "scene") +
                                       ", the limit is --principal-scenes-max " +
                                       std::to_string(limits_.principal_scenes_max) + "; " +
                                       remedy(principal,
                                              "start raynestd with a larger "
                                              "--principal-scenes-max",
                                              Short::names_or_disk));
    if (bytes > bytes_max || held > bytes_max - bytes)
        return refuse(Code::quota,
                      principal + " holds " + protocol::bytes_text(held) + " of scenes, " +
                          protocol::bytes_text(bytes) + " more are too many: " +
                          quotas_.limit_text(principal, &Quota::scene_bytes) + "; " +
                          remedy(principal, quotas_.remedy(principal, &Quota::scene_bytes)));
    return {};
}

Reply<void> SceneStore::check_quota(std::string_view name, const ConnectionId& caller,
                                    std::uint64_t bytes) const {
    if (const auto holds = check_holds(caller.principal); !holds) return holds;
    return check_quota(own_entry(name, caller), caller.principal, bytes);
}

Reply<NamedScene> SceneStore::publish(const std::string& name,
                                      std::shared_ptr<const Snapshot> snapshot, Publication how,
                                      const ConnectionId& caller) {
    forget_freed();

    // The checks of a stored scene were made before its row was committed.
    const bool is_stored = how.blob != nullptr;
    if (!is_stored)
        if (const auto allowed = check_publication(name, *snapshot, how, caller); !allowed)
            return tl::unexpected(allowed.error());
    const auto found = own(entries_, name, caller);
    const bool taken = found != entries_.end();
    const bool equal = taken && found->second.has_content(*snapshot);

    // Complete the entry before it enters the table, so that a lack of memory changes nothing.
    Entry entry = taken ? found->second : Entry();
    if (how.blob != nullptr)
        entry.scene.epoch = how.row.epoch;
    else if (!equal)
        entry.scene.epoch = entry.next_epoch();
    entry.used = now_();
    entry.scene.build_seconds = snapshot->statistics().build_seconds;
    if (entry.facts.arena != snapshot->arena_id() || entry.scene.held == nullptr) {
        entry.facts = facts_of(*snapshot);
        auto held = hold(std::move(snapshot), caller.principal);
        if (!held) return tl::unexpected(held.error());
        entry.scene.held = std::move(*held);
        entry.lower_holds();
    }
    if (!equal) {
        entry.scene.name = name;
        entry.scene.last_edit.clear();
        entry.owner = caller.principal;
        entry.loaded = entry.used;
        entry.made_of.clear();
        entry.spare.reset();
        entry.earlier.clear();
        entry.blob.reset();
    }
    entry.damage.clear();
    entry.from_before = false;
    if (how.blob) {
        mend({*how.blob});
        entry.blob = std::move(how.blob);
        entry.stored = std::move(how.row);
        entry.edits = entry.edit_bytes = 0;
        entry.epoch_reserved = entry.stored.epoch;
    }
    if (!how.made_of.empty()) entry.made_of = std::move(how.made_of);
    if (!how.share.empty()) {
        auto share = is_stored ? entry.stored.share : charge_list(how.share, caller.principal);
        if (!share) return tl::unexpected(share.error());
        entry.share = std::move(*share);
        entry.earlier.clear();  // they may hold what an edit took out before others were let in
        // Whom the owner leaves out now sees nothing of it any more, also not by a hold from before.
        if (!entry.share.is_public())
            std::erase_if(entry.holders, [&](const auto& holder) {
                return holder.first != entry.owner && !entry.share.contains(holder.first);
            });
    }
    if (!how.temporary) entry.kept = true;
    const bool temporary = how.temporary && (!entry.held_by(caller) || entry.temporary_of(caller));
    entry.holders[caller.principal].insert_or_assign(caller.connection,
                                                     Entry::Hold{temporary, entry.facts.bytes});
    NamedScene scene = entry.scene_for(caller);
    holding_.insert(caller.connection);
    entry.unsettle();
    if (taken) {
        found->second.unsettle();
        found->second = std::move(entry);
    } else {
        entries_.emplace(name, std::move(entry));
    }
    // Release an unloaded scene of this name that the caller still holds: for the caller, the name
    // means the new scene.
    const auto [first, last] = entries_.equal_range(name);
    const auto before = std::find_if(first, last, [&](const auto& known) {
        return !known.second.listed && known.second.owner == caller.principal &&
               known.second.held_by(caller);
    });
    if (before != last) {
        if (before->second.release(caller)) entries_.erase(before);
    }
    settle_charges();
    return scene;
}

Reply<void> SceneStore::may_edit(std::string_view name, const ConnectionId& caller) const {
    const auto found = resolve(entries_, name, caller);
    if (found == entries_.end()) return tl::unexpected(not_found(name, caller));
    return access::edit_scene(name, found->second.owner, caller);
}

std::shared_ptr<const Snapshot> SceneStore::take_spare(const NamedScene& of,
                                                       const ConnectionId& caller) {
    const auto found = resolve(entries_, of.name, caller);
    if (found == entries_.end() || found->second.scene.held != of.held) return nullptr;
    const auto spare = std::exchange(found->second.spare, nullptr);
    if (spare == nullptr || spare.use_count() != 1) return nullptr;
    return std::exchange(const_cast<HeldScene&>(*spare).snapshot, nullptr);
}

void SceneStore::drop_spares() {
    for (auto& [name, entry] : entries_) entry.spare.reset();
}

bool SceneStore::holds(const std::string& arena) const {
    const auto known = by_arena_.find(arena);
    return known != by_arena_.end() && !known->second.expired();
}

bool SceneStore::shows(const std::string& hash, const ConnectionId& caller) const {
    return std::ranges::any_of(entries_, [&](const auto& entry) {
        return entry.second.visible_to(caller) && entry.second.facts.digest == hash;
    });
}

protocol::Error SceneStore::not_found(std::string_view name, const ConnectionId& caller) const {
    std::string several;
    const auto [first, last] = entries_.equal_range(name);
    const HeldNames held = held_names(std::ranges::subrange(first, last), caller);
    for (auto at = first; at != last; ++at)
        if (found_by(at->second, caller, held))
            several += (several.empty() ? "" : ", ") + at->second.name_for(caller);
    if (several.empty()) return unknown(name);
    const char* what = caller.role == Role::admin ? "several owners have a scene '"
                                                  : "several owners share a scene '";
    return {Code::scene_unknown, what + std::string(name) + "'; name one of " + several, 0};
}

Reply<NamedScene> SceneStore::find(std::string_view name, std::uint64_t epoch,
                                   const ConnectionId& caller) const {
    return found_at(resolve(entries_, name, caller), name, epoch, caller);
}

Reply<std::vector<NamedScene>> SceneStore::find_each(const std::vector<std::string>& names,
                                                     const ConnectionId& caller) const {
    std::vector<NamedScene> scenes;
    if (names.empty()) return scenes;
    std::map<std::string_view, Choice<Entries::const_iterator>> choices;
    for (const std::string& name : names) choices.try_emplace(name, entries_.end());
    for (auto at = entries_.begin(); at != entries_.end(); ++at) {
        const std::string qualified = at->second.owner + '/' + at->first;
        if (const auto choice = choices.find(at->first); choice != choices.end())
            choice->second.look_at(at, false, caller);
        if (const auto choice = choices.find(qualified); choice != choices.end())
            choice->second.look_at(at, true, caller);
    }
    for (const std::string& name : names) {
        auto scene = found_at(choices.at(name).result(), name, 0, caller);
        if (!scene) return tl::unexpected(scene.error());
        scenes.push_back(std::move(*scene));
    }
    return scenes;
}

Reply<NamedScene> SceneStore::found_at(Entries::const_iterator found, std::string_view name,
                                       std::uint64_t epoch, const ConnectionId& caller) const {
    if (found == entries_.end()) return tl::unexpected(not_found(name, caller));
    const NamedScene& scene = found->second.scene;
    if (epoch != 0 && epoch != scene.epoch)
        return refuse(Code::scene_unknown, "scene '" + scene.name + "' is at epoch " +
                                               std::to_string(scene.epoch) + ", not " +
                                               std::to_string(epoch) + "; leave `epoch` out");
    found->second.used = now_();
    if (scene.held == nullptr) return tl::unexpected(asleep(found->second));
    return read_by(found->second.scene_for(caller), caller.principal);
}

Reply<NamedScene> SceneStore::open(std::string_view name, const ConnectionId& caller) {
    auto scene = find(name, 0, caller);
    if (!scene) return scene;
    Entry& entry = resolve(entries_, name, caller)->second;
    if (entry.held_by(caller)) return scene;
    if (const auto holds = check_holds(caller.principal); !holds)
        return tl::unexpected(holds.error());
    // Bytes that are charged to the caller already take nothing more.
    if (const auto quota = check_quota(&entry, caller.principal, entry.facts.bytes);
        !quota && entry.charge(caller.principal) != entry.facts.bytes)
        return tl::unexpected(quota.error());
    holding_.insert(caller.connection);
    entry.holders[caller.principal].emplace(caller.connection,
                                            Entry::Hold{false, entry.facts.bytes});
    entry.unsettle();
    return scene;
}

Reply<std::vector<std::string>> SceneStore::unload(std::string_view name,
                                                   const ConnectionId& caller) {
    const auto found = resolve(entries_, name, caller);
    if (found == entries_.end()) return tl::unexpected(not_found(name, caller));
    Entry& entry = found->second;
    const bool may_drop_name = entry.owner == caller.principal || caller.role == Role::admin;
    if (const auto allowed =
            access::unload_scene(name, entry.owner, may_drop_name || entry.held_by(caller));
        !allowed)
        return tl::unexpected(allowed.error());

    auto holders = drop(found, caller);
    settle_charges();
    return holders;
}

std::vector<std::string> SceneStore::drop(Entries::iterator found, const ConnectionId& caller) {
    Entry& entry = found->second;
    const bool may_drop_name = entry.owner == caller.principal || caller.role == Role::admin;
    if (may_drop_name && !entry.temporary_of(caller)) {
        if (entry.stored.number != 0) dropped_.push_back(entry.stored);
        entry.stored = {};
        // Those who hold it still have it in memory; its room on the disk is free.
        if (entry.scene.held != nullptr) entry.blob.reset();
        entry.kept = entry.listed = false;
    }
    const bool last = entry.release(caller);
    std::vector<std::string> holders;
    if (entry.kept) holders.push_back(entry.owner + " (by its name)");
    for (const auto& [principal, connections] : entry.holders)
        holders.push_back(principal + " (" + counted(connections.size(), "connection") + ")");
    if (last) entries_.erase(found);
    return holders;
}

std::vector<SceneStore::Unloaded> SceneStore::unload_idle(Clock::duration idle, std::size_t most,
                                                          const ConnectionId& caller) {
    const Clock::time_point now = now_();
    const HeldNames held = held_names(entries_, caller);
    std::vector<Entries::iterator> found;
    for (auto at = entries_.begin(); at != entries_.end() && found.size() < most; ++at) {
        const Entry& entry = at->second;
        const bool mine = entry.held_by(caller) ||
                          (entry.listed && entry.kept && entry.owner == caller.principal);
        if (mine && now - entry.used >= idle && found_by(entry, caller, held)) found.push_back(at);
    }
    std::vector<Unloaded> unloaded;
    for (const auto at : found) unloaded.push_back({at->second.name_for(caller), drop(at, caller)});
    settle_charges();
    return unloaded;
}

SceneStore::Page SceneStore::page(const ConnectionId& caller, std::size_t first,
                                  std::size_t most) const {
    const Clock::time_point now = now_();
    const HeldNames held = held_names(entries_, caller);
    Page page;
    for (const auto& [name, known] : entries_) {
        if (!found_by(known, caller, held)) continue;
        if (page.total++ < first || page.scenes.size() == most) continue;
        page.scenes.push_back({known.scene_for(caller), known.owner, known.share.short_text(),
                               now - known.loaded, now - known.used, known.connections(),
                               known.facts,
                               known.scene.held       ? (known.pinned ? "pinned" : "memory")
                               : known.damage.empty() ? "disk"
                                                      : "damaged"});
    }
    return page;
}

}  // namespace raynest::server
