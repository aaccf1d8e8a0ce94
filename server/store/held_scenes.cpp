// The memory of scenes: each arena once, what epochs share once, and who is charged for it.
#include "server/store/held_parts.h"
#include "server/store/scene_store.h"

#include <algorithm>
#include <map>
#include <memory>
#include <new>
#include <set>
#include <string>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

/// Principals whose requests have read a scene and no longer do are forgotten beyond so many.
constexpr std::size_t readers_kept_max = 16;
/// Up to so many bytes, a list counts as little as the name of its scene does.
constexpr std::uint64_t list_bytes_free = 4096;

}  // namespace

bool SceneStore::Entry::charged_to(const std::string& principal) const {
    return (kept && owner == principal) || holders.contains(principal);
}

std::uint64_t SceneStore::Entry::charge(const std::string& principal) const {
    if (!scene.held) return 0;
    if (owner == principal) return is_owners() ? facts.bytes : 0;
    const auto found = holders.find(principal);
    if (found == holders.end()) return 0;
    std::uint64_t opened = 0;
    for (const auto& [connection, hold] : found->second) opened = std::max(opened, hold.bytes);
    return std::min(opened, facts.bytes);
}

Reply<void> SceneStore::check_holds(const std::string& principal) const {
    std::uint64_t holds = 0;
    for (const auto& [name, entry] : entries_)
        if (const auto held = entry.holders.find(principal); held != entry.holders.end())
            holds += held->second.size();
    if (holds < limits_.principal_holds_max) return {};
    return refuse(
        Code::quota,
        "the connections of " + principal + " hold " + std::to_string(holds) + " scenes" +
            ", the limit is principal_holds_max = " + std::to_string(limits_.principal_holds_max) +
            "; close connections or scenes that are done");
}

void SceneStore::Entry::lower_holds() {
    for (auto& [principal, connections] : holders)
        if (principal != owner)
            for (auto& [connection, hold] : connections)
                hold.bytes = std::min(hold.bytes, facts.bytes);
}

void SceneStore::Entry::unsettle() const {
    if (scene.held) scene.held->is_unsettled = true;
}

void SceneStore::settle_charges() noexcept {
    try {
        std::map<std::shared_ptr<const HeldScene>, Sharers> unsettled;
        for (const auto& [arena, known] : by_arena_)
            if (auto held = known.lock(); held && (held->is_unsettled || held->is_left_to_readers))
                unsettled.try_emplace(std::move(held));
        if (unsettled.empty()) return;
        for (const auto& [name, entry] : entries_)
            if (const auto& held = entry.scene.held; held && held->is_unsettled)
                unsettled[held].push_back(&entry);
        for (const auto& [held, sharers] : unsettled) settle_charge(*held, sharers);
    } catch (const std::bad_alloc&) {
        // Unsettled ones stay as they are until the next settling.
    }
}

void SceneStore::settle_charge(const HeldScene& held, const Sharers& sharers) {
    if (sharers.empty()) {
        leave_to_readers(held);
    } else {
        held.is_left_to_readers = false;
        const Entry& first = *sharers.front();
        if (std::ranges::none_of(sharers, [&](const Entry* entry) {
                return entry->charged_to(held.lease.principal());
            }))
            held.lease.charge(first.is_owners() ? first.owner : first.holders.begin()->first);
        held.unpaid = {};
        held.unpaid = budget_.count_unpaid(unpaid_of(held, sharers));
    }
    held.is_unsettled = false;
}

Budget::Unpaid::Bytes SceneStore::unpaid_of(const HeldScene& held, const Sharers& sharers) {
    const std::string& payer = held.lease.principal();
    // An owner may have the content under many names: the oldest one counts, which tells no more.
    std::map<std::pair<std::string_view, bool>, const Entry*> oldest;
    for (const Entry* const entry : sharers) {
        const Entry*& known = oldest[{entry->owner, entry->is_owners()}];
        if (known == nullptr || entry->loaded < known->loaded) known = entry;
    }
    /// The entries of others that an owner sees.
    struct Sight {
        bool payers = false;  ///< one of those who is charged is among them
        Clock::time_point oldest = Clock::time_point::max();

        void add(const Sight& other) {
            payers = payers || other.payers;
            oldest = std::min(oldest, other.oldest);
        }
    };
    std::map<std::string_view, Sight> seen;
    for (const auto& [owner, entry] : oldest) seen[owner.first];
    const auto sight_of = [&](const Entry& entry) {
        return Sight{entry.charged_to(payer), entry.loaded};
    };
    for (const auto& [owner, entry] : oldest) {
        const auto show = [&, entry = entry, sight = sight_of(*entry)](std::string_view principal) {
            const auto known = seen.find(principal);
            if (known != seen.end() && principal != entry->owner) known->second.add(sight);
        };
        if (entry->share.is_public()) continue;
        for (const std::string_view name : entry->share.names()) show(name);
        for (const auto& [holder, connections] : entry->holders) show(holder);
    }
    // Public ones are shown to all others: to those that come later, and then to those before.
    const auto show_public = [&](auto first, const auto& last) {
        Sight before, same;
        for (std::string_view owner; first != last; ++first) {
            const auto& [key, entry] = *first;
            if (std::exchange(owner, key.first) != key.first) before.add(std::exchange(same, {}));
            seen[owner].add(before);
            if (entry->share.is_public()) same.add(sight_of(*entry));
        }
    };
    show_public(oldest.begin(), oldest.end());
    show_public(oldest.rbegin(), oldest.rend());
    Budget::Unpaid::Bytes unpaid;
    for (const auto& [owner, entry] : oldest) {
        if (!owner.second || entry->owner == payer) continue;
        // The first of those that it sees would be charged if there were no others.
        const Sight& others = seen[owner.first];
        if (!others.payers && others.oldest >= entry->loaded)
            unpaid.emplace(entry->owner, entry->facts.bytes);
    }
    return unpaid;
}

void SceneStore::leave_to_readers(const HeldScene& held) noexcept {
    held.unpaid = {};
    if (held.lease.bytes() == 0) return;
    const std::string& charged = held.lease.principal();
    const std::string* reader = held.reader([&](const auto& each) { return each == charged; });
    if (reader == nullptr) reader = held.reader([](const auto&) { return true; });
    if (reader == nullptr) return;
    held.is_left_to_readers = true;
    try {
        held.lease.charge(*reader);
    } catch (const std::bad_alloc&) {
        // It stays as it is until the next settling.
    }
}

NamedScene SceneStore::read_by(NamedScene scene, const std::string& principal) {
    std::weak_ptr<const void>& known = scene.held->readers[principal];
    scene.reading = known.lock();
    if (scene.reading) return scene;
    known = scene.reading = std::make_shared<const char>();
    if (auto& readers = scene.held->readers; readers.size() > readers_kept_max)
        std::erase_if(readers, [](const auto& reader) { return reader.second.expired(); });
    return scene;
}

std::uint64_t SceneStore::memory_of(const std::string& principal) const {
    std::map<const HeldScene*, std::uint64_t> own;
    std::set<const HeldScene*> of_others;
    for (const auto& [name, entry] : entries_) {
        const HeldScene* held = entry.scene.held.get();
        if (held == nullptr) continue;
        if (!entry.charged_to(principal))
            of_others.insert(held);
        else
            own[held] = std::max(own[held], entry.charge(principal));
        if (entry.spare && entry.owner == principal)
            own.emplace(entry.spare.get(), entry.spare->lease.bytes());
    }
    // Asked for first: a scene may be freed meanwhile on another thread, but none comes.
    std::uint64_t bytes = budget_.held_by(principal);
    const auto is_charged = [&](const Budget::Lease& lease) {
        return lease.bytes() != 0 && lease.principal() == principal;
    };
    for (const auto& [arena, known] : by_arena_) {
        const auto held = known.lock();
        if (!held) continue;
        const std::uint64_t charged = is_charged(held->lease) ? held->lease.bytes() : 0;
        std::uint64_t told = 0;
        if (const auto found = own.find(held.get()); found != own.end())
            told = found->second;
        else if (held->is_left_to_readers)
            told = held->reader([&](const auto& each) { return each == principal; }) != nullptr
                       ? held->lease.bytes()
                       : 0;
        else if (!of_others.contains(held.get()))
            told = charged;  // a job has it, or a load before it has its name
        bytes = bytes - charged + told;
    }
    // The bytes of each scene have them already.
    for (const auto& [pages, known] : shared_leases_)
        if (const auto lease = known.lock(); lease && is_charged(*lease)) bytes -= lease->bytes();
    return bytes;
}

void SceneStore::forget_freed() {
    const auto is_freed = [](const auto& known) { return known.second.expired(); };
    std::erase_if(by_arena_, is_freed);
    std::erase_if(shared_leases_, is_freed);
}

Reply<std::shared_ptr<const HeldScene>> SceneStore::hold(std::shared_ptr<const Snapshot> snapshot,
                                                         const std::string& principal) {
    std::weak_ptr<const HeldScene>& known = by_arena_[snapshot->arena_id()];
    if (auto held = known.lock()) return held;

    const auto reserve = [&](std::uint64_t bytes) -> Reply<Budget::Lease> {
        auto lease = budget_.reserve(bytes, principal, Use::lasting);
        if (lease) return std::move(*lease);
        drop_spares();
        lease = budget_.reserve(bytes, principal, Use::lasting);
        if (lease) return std::move(*lease);
        return budget_.refuse("the scene", bytes, principal,
                              remedy(principal, "start raynestd with a larger --memory"));
    };
    std::shared_ptr<const Budget::Lease> shared;
    if (const auto& pages = snapshot->shared()) {
        std::weak_ptr<const Budget::Lease>& leased = shared_leases_[pages.get()];
        shared = leased.lock();
        if (!shared) {
            auto lease = reserve(pages->size());
            if (!lease) return tl::unexpected(std::move(lease.error()));
            leased = shared = std::make_shared<const Budget::Lease>(std::move(*lease));
        }
    }
    auto lease = reserve(snapshot->own_bytes());
    if (!lease) return tl::unexpected(std::move(lease.error()));
    const auto held = with_memory({std::move(snapshot), std::move(*lease), std::move(shared)});
    known = held;
    return held;
}

Reply<ShareList> SceneStore::charge_list(const ShareList& list,
                                         const std::string& principal) const {
    if (list.bytes() <= list_bytes_free) return list;
    auto lease = budget_.reserve(list.bytes(), principal, Use::lasting);
    if (!lease)
        return budget_.refuse("the list of those that the scene is shared with", list.bytes(),
                              principal,
                              remedy(principal, "start raynestd with a larger --memory"));
    return list.with_end([lease = std::make_shared<Budget::Lease>(std::move(*lease)),
                          dispose = dispose_](std::shared_ptr<const void> content) mutable {
        lease.reset();
        if (*dispose) (*dispose)(std::move(content));
    });
}

std::shared_ptr<const HeldScene> SceneStore::with_memory(HeldScene scene) const {
    return {new HeldScene(std::move(scene)), [dispose = dispose_](const HeldScene* held) {
                auto freed = held->snapshot;
                delete held;
                if (freed && *dispose) (*dispose)(std::move(freed));
            }};
}

std::shared_ptr<const HeldScene> SceneStore::find_made_of(const std::string& digest,
                                                          const ConnectionId& caller) const {
    std::shared_ptr<const HeldScene> found;
    for (const auto& [name, entry] : entries_)
        if (entry.made_of == digest && entry.visible_to(caller) && entry.scene.held)
            found = entry.scene.held;
    return found;
}

std::vector<std::shared_ptr<const HeldScene>> SceneStore::visible_scenes(
    const ConnectionId& caller) const {
    std::vector<const Entry*> entries;
    for (const auto& [name, entry] : entries_)
        if (entry.visible_to(caller) && entry.scene.held) entries.push_back(&entry);
    std::ranges::sort(entries, std::greater{}, &Entry::used);
    std::set<const HeldScene*> seen;
    std::vector<std::shared_ptr<const HeldScene>> scenes;
    for (const Entry* entry : entries) {
        const auto& held = entry->scene.held;
        if (!seen.insert(held.get()).second) continue;
        if (!held->part_digests) held->part_digests = std::make_shared<PartDigests>();
        scenes.push_back(held);
    }
    return scenes;
}

}  // namespace raynest::server
