#include "server/store/scene_store.h"

#include "protocol/text.h"
#include "server/access.h"

#include <algorithm>
#include <utility>

namespace raynest::server {
namespace {

/// Maximum number of scenes that an error message proposes to unload.
constexpr std::size_t proposals_max = 3;

std::string counted(std::size_t count, const char* thing) {
    return std::to_string(count) + " " + thing + (count == 1 ? "" : "s");
}

}  // namespace

const std::string& SceneStore::Entry::owner() const {
    if (charged_to(loader) || (owners.empty() && holders.empty())) return loader;
    return owners.empty() ? holders.begin()->first : *owners.begin();
}

bool SceneStore::Entry::held_by(const ConnectionId& caller) const {
    const auto found = holders.find(caller.principal);
    return found != holders.end() && found->second.contains(caller.connection);
}

bool SceneStore::Entry::temporary_of(const ConnectionId& caller) const {
    return held_by(caller) && holders.at(caller.principal).at(caller.connection);
}

bool SceneStore::Entry::charged_to(const std::string& principal) const {
    return owners.contains(principal) || holders.contains(principal);
}

std::size_t SceneStore::Entry::connections() const {
    std::size_t count = 0;
    for (const auto& [principal, numbers] : holders) count += numbers.size();
    return count;
}

bool SceneStore::Entry::release(const ConnectionId& caller) noexcept {
    const auto found = holders.find(caller.principal);
    if (found != holders.end()) {
        found->second.erase(caller.connection);
        if (found->second.empty()) holders.erase(found);
    }
    return owners.empty() && holders.empty();
}

bool SceneStore::Entry::only_of(const std::string& principal) const {
    if (owners.empty()) return holders.size() == 1 && holders.contains(principal);
    return owners.size() == 1 && owners.contains(principal);
}

template <class AnyEntries>
auto SceneStore::resolve(AnyEntries& entries, std::string_view name, const ConnectionId& caller) {
    auto found = entries.end();
    const auto [first, last] = entries.equal_range(name);
    for (auto entry = first; entry != last; ++entry) {
        if (entry->second.held_by(caller)) return entry;
        if (entry->second.listed) found = entry;
    }
    return found;
}

SceneStore::Entries::iterator SceneStore::listed(std::string_view name) {
    const auto [first, last] = entries_.equal_range(name);
    const auto found =
        std::find_if(first, last, [](const auto& entry) { return entry.second.listed; });
    return found == last ? entries_.end() : found;
}

void SceneStore::disconnect(const ConnectionId& caller) noexcept {
    for (auto entry = entries_.begin(); entry != entries_.end();) {
        const auto next = std::next(entry);
        if (entry->second.held_by(caller) && entry->second.release(caller)) entries_.erase(entry);
        entry = next;
    }
}

Reply<std::shared_ptr<const HeldScene>> SceneStore::hold(std::shared_ptr<const Snapshot> snapshot,
                                                         const std::string& principal) {
    std::weak_ptr<const HeldScene>& known = by_digest_[snapshot->digest()];
    if (auto held = known.lock()) return held;

    const std::uint64_t bytes = snapshot->bytes().size();
    auto lease = budget_.reserve(bytes);
    if (!lease)
        return refuse(Code::resource_exhausted,
                      "the scene takes " + protocol::bytes_text(bytes) + ", " +
                          protocol::bytes_text(budget_.limit() - budget_.used()) +
                          " of raynestd's --memory are free; " + remedy(principal, "--memory"));
    auto held =
        std::make_shared<const HeldScene>(HeldScene{std::move(snapshot), std::move(*lease)});
    known = held;
    return held;
}

std::string SceneStore::remedy(const std::string& principal, std::string_view option) const {
    const std::string larger = "start raynestd with a larger " + std::string(option);
    if (entries_.empty()) return larger;
    std::vector<const Entry*> candidates;
    for (const auto& [name, entry] : entries_)
        if (entry.owners.contains(principal)) candidates.push_back(&entry);
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

Reply<void> SceneStore::check_quota(const Entry* changed, const ConnectionId& caller,
                                    std::uint64_t bytes) const {
    const std::string& principal = caller.principal;
    std::uint64_t scenes = 0;
    std::uint64_t held = 0;
    for (const auto& [name, entry] : entries_) {
        if (&entry == changed || !entry.charged_to(principal)) continue;
        ++scenes;
        held += entry.scene.snapshot().bytes().size();
    }
    if (scenes >= limits_.principal_scenes_max)
        return refuse(Code::quota, principal + " holds " + counted(scenes, "scene") +
                                       ", the limit is --principal-scenes-max " +
                                       std::to_string(limits_.principal_scenes_max) + "; " +
                                       remedy(principal, "--principal-scenes-max"));
    if (bytes > limits_.principal_scene_bytes_max ||
        held > limits_.principal_scene_bytes_max - bytes)
        return refuse(Code::quota, principal + " holds " + protocol::bytes_text(held) +
                                       " of scenes, " + protocol::bytes_text(bytes) +
                                       " more are over --principal-scene-bytes-max " +
                                       std::to_string(limits_.principal_scene_bytes_max) + "; " +
                                       remedy(principal, "--principal-scene-bytes-max"));
    return {};
}

Reply<void> SceneStore::check_quota(std::string_view name, const ConnectionId& caller,
                                    std::uint64_t bytes) const {
    const auto known = resolve(entries_, name, caller);
    return check_quota(known == entries_.end() ? nullptr : &known->second, caller, bytes);
}

Reply<NamedScene> SceneStore::publish(const std::string& name,
                                      std::shared_ptr<const Snapshot> snapshot, Publication how,
                                      const ConnectionId& caller) {
    std::erase_if(by_digest_, [](const auto& known) { return known.second.expired(); });

    const auto found = listed(name);
    const bool taken = found != entries_.end();
    if (const auto quota = check_quota(name, caller, snapshot->bytes().size()); !quota)
        return tl::unexpected(quota.error());
    const bool equal = taken && found->second.scene.snapshot().digest() == snapshot->digest();
    if (taken && !equal && !how.replace)
        return refuse(Code::name_taken, "another scene is called '" + name +
                                            "'; give this one another `name`, or put it in the "
                                            "other's place with `replace`");
    if (taken && !equal)
        if (const auto allowed =
                access::replace_scene(name, found->second.only_of(caller.principal));
            !allowed)
            return tl::unexpected(allowed.error());

    // Complete the entry before it enters the table, so that a lack of memory changes nothing.
    Entry entry = taken ? found->second : Entry();
    entry.used = now_();
    if (!equal) {
        auto held = hold(std::move(snapshot), caller.principal);
        if (!held) return tl::unexpected(held.error());
        entry.scene.name = name;
        entry.scene.held = std::move(*held);
        ++entry.scene.epoch;
        entry.loader = caller.principal;
        entry.loaded = entry.used;
    }
    if (!how.temporary) entry.owners.insert(caller.principal);
    const bool temporary = how.temporary && (!entry.held_by(caller) || entry.temporary_of(caller));
    entry.holders[caller.principal].insert_or_assign(caller.connection, temporary);
    NamedScene scene = entry.scene;
    if (taken)
        found->second = std::move(entry);
    else
        entries_.emplace(name, std::move(entry));
    // Release an unloaded scene of this name that the caller still holds: for the caller, the name
    // means the new scene.
    const auto [first, last] = entries_.equal_range(name);
    const auto before = std::find_if(first, last, [&](const auto& known) {
        return !known.second.listed && known.second.held_by(caller);
    });
    if (before != last && before->second.release(caller)) entries_.erase(before);
    return scene;
}

bool SceneStore::holds(const std::string& hash) const {
    const auto known = by_digest_.find(hash);
    return known != by_digest_.end() && !known->second.expired();
}

Reply<NamedScene> SceneStore::find(std::string_view name, std::uint64_t epoch,
                                   const ConnectionId& caller) const {
    const auto found = resolve(entries_, name, caller);
    if (found == entries_.end() && name.find_first_of(":.") != std::string_view::npos)
        return refuse(Code::scene_unknown,
                      "no scene is called '" + std::string(name) +
                          "'; if that is a source, `Load` it first and ask by the scene's name");
    if (found == entries_.end())
        return refuse(Code::scene_unknown, "scene '" + std::string(name) +
                                               "' is not loaded; see `Scenes`, or `Load` it");
    const NamedScene& scene = found->second.scene;
    if (epoch != 0 && epoch != scene.epoch)
        return refuse(Code::scene_unknown, "scene '" + scene.name + "' is at epoch " +
                                               std::to_string(scene.epoch) + ", not " +
                                               std::to_string(epoch) + "; leave `epoch` out");
    found->second.used = now_();
    return scene;
}

Reply<NamedScene> SceneStore::open(std::string_view name, const ConnectionId& caller) {
    auto scene = find(name, 0, caller);
    if (!scene) return scene;
    Entry& entry = resolve(entries_, name, caller)->second;
    if (entry.held_by(caller)) return scene;
    if (const auto quota = check_quota(&entry, caller, scene->snapshot().bytes().size()); !quota)
        return tl::unexpected(quota.error());
    entry.holders[caller.principal].emplace(caller.connection, false);
    return scene;
}

Reply<std::vector<std::string>> SceneStore::unload(std::string_view name,
                                                   const ConnectionId& caller) {
    const auto found = resolve(entries_, name, caller);
    if (found == entries_.end())
        return refuse(Code::scene_unknown,
                      "scene '" + std::string(name) + "' is not loaded; see `Scenes`");
    Entry& entry = found->second;
    const bool temporary_of_mine = entry.owners.empty() && entry.holders.contains(caller.principal);
    const bool mine =
        entry.owners.contains(caller.principal) || entry.held_by(caller) || temporary_of_mine;
    if (const auto allowed = access::unload_scene(name, entry.owner(), mine); !allowed)
        return tl::unexpected(allowed.error());

    if (!entry.temporary_of(caller)) {
        entry.owners.erase(caller.principal);
        entry.listed = !entry.owners.empty();
    }
    const bool last = entry.release(caller);
    std::vector<std::string> holders;
    for (const std::string& owner : entry.owners) holders.push_back(owner + " (by its name)");
    for (const auto& [principal, connections] : entry.holders)
        holders.push_back(principal + " (" + counted(connections.size(), "connection") + ")");
    if (last) entries_.erase(found);
    return holders;
}

std::vector<SceneStore::Unloaded> SceneStore::unload_idle(Clock::duration idle, std::size_t most,
                                                          const ConnectionId& caller) {
    const Clock::time_point now = now_();
    std::vector<std::string> names;
    for (const auto& [name, entry] : entries_) {
        if (names.size() == most) break;
        const bool mine =
            entry.held_by(caller) || (entry.listed && entry.owners.contains(caller.principal));
        // Skip a scene that is hidden by another of that name which the caller holds.
        if (mine && now - entry.used >= idle && &resolve(entries_, name, caller)->second == &entry)
            names.push_back(name);
    }
    std::vector<Unloaded> unloaded;
    for (const std::string& name : names)
        if (auto holders = unload(name, caller)) unloaded.push_back({name, std::move(*holders)});
    return unloaded;
}

std::vector<SceneStore::Listed> SceneStore::list(const ConnectionId& caller) const {
    const Clock::time_point now = now_();
    std::vector<Listed> scenes;
    scenes.reserve(entries_.size());
    for (auto entry = entries_.begin(); entry != entries_.end();
         entry = entries_.upper_bound(entry->first)) {
        const auto meant = resolve(entries_, entry->first, caller);
        if (meant == entries_.end()) continue;
        const Entry& known = meant->second;
        scenes.push_back({known.scene, known.owner(), now - known.loaded, now - known.used,
                          known.connections()});
    }
    return scenes;
}

std::uint64_t SceneStore::bytes() const {
    std::uint64_t sum = 0;
    for (const auto& [digest, held] : by_digest_)
        if (const auto scene = held.lock()) sum += scene->snapshot->bytes().size();
    return sum;
}

SceneStore::Total SceneStore::unlisted() const {
    Total total;
    for (const auto& [name, entry] : entries_) {
        if (entry.listed) continue;
        ++total.scenes;
        total.bytes += entry.scene.snapshot().bytes().size();
    }
    return total;
}

}  // namespace raynest::server
