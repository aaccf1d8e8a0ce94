// SceneStore: what is stored, and which scenes are in memory.
#include "server/store/scene_store.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <ctime>
#include <utility>

namespace raynest::server {
namespace {

constexpr std::int64_t ms_of_second = 1000;

std::int64_t wall_ms() {
    return std::chrono::duration_cast<std::chrono::milliseconds>(
               std::chrono::system_clock::now().time_since_epoch())
        .count();
}

}  // namespace

StoredScene SceneStore::Entry::row() const {
    return {.owner = owner,
            .name = scene.name,
            .share = share,
            .digest = facts.arena,
            .content = facts.digest,
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
    if (taken != nullptr && !taken->has_content(snapshot) && !how.replace && taken->damage.empty())
        return refuse(Code::name_taken, "another scene is called '" + name +
                                            "'; give this one another `name`, or put it in the "
                                            "other's place with `replace`");
    return {};
}

Reply<SceneStore::Stored> SceneStore::prepare_to_store(const std::string& name,
                                                       std::shared_ptr<const Snapshot> snapshot,
                                                       const Publication& how,
                                                       const ConnectionId& caller,
                                                       std::uint64_t epochs_free) {
    if (const auto allowed = check_publication(name, *snapshot, how, caller); !allowed)
        return tl::unexpected(allowed.error());
    const Entry* const taken = own_entry(name, caller);
    const SceneFacts facts = facts_of(*snapshot);
    const DiskRoom room = room_for(taken, caller.principal);
    if (const auto fits = room.check(facts.arena, facts.bytes); !fits)
        return tl::unexpected(fits.error());
    Stored stored;
    const bool is_new = taken == nullptr || !taken->charged_to(caller.principal);
    stored.claim = claims_.take(caller.principal, {room.needed_for(facts.arena, facts.bytes),
                                                   is_new ? 1U : 0U, facts.bytes});
    if (taken != nullptr) stored.row = taken->row();
    if (taken != nullptr && taken->stored.number != 0)
        stored.before = std::make_unique<StoredScene>(taken->stored);
    const bool equal = taken != nullptr && taken->has_content(*snapshot);
    stored.row.owner = caller.principal;
    stored.row.name = name;
    // Edits may be told of epochs that are reserved while the row is written; then this daemon may die.
    if (!equal)
        stored.row.epoch =
            taken == nullptr
                ? 1
                : std::max(taken->next_epoch(), taken->epoch_reserved + 1) + epochs_free;
    if (!how.share.empty()) {
        auto share = charge_list(how.share, caller.principal);
        if (!share) return tl::unexpected(share.error());
        stored.row.share = std::move(*share);
    }
    stored.row.digest = facts.arena;
    stored.row.content = facts.digest;
    stored.row.bytes = facts.bytes;
    stored.row.instanced_triangles = facts.instanced_triangles;
    stored.row.build_seconds = snapshot->statistics().build_seconds;
    stored.row.used = std::time(nullptr);
    auto held = hold(std::move(snapshot), caller.principal);
    if (!held) return tl::unexpected(held.error());
    stored.held = std::move(*held);
    return stored;
}

bool SceneStore::is_outdated(const StoredScene& row, const ConnectionId& caller) const {
    const Entry* const taken = own_entry(row.name, caller);
    if (taken == nullptr) return false;
    const bool equal = taken->facts.digest == row.content || taken->facts.arena == row.digest;
    return row.epoch < (equal ? taken->scene.epoch : taken->next_epoch());
}

void SceneStore::DiskUse::add(const Entry& entry) {
    bytes += entry.edit_bytes;
    auto [blob, size] = entry.on_disk();
    if (!blob.empty() && blobs.insert(std::move(blob)).second) bytes += size;
}

SceneStore::DiskUse SceneStore::disk_use(const std::string& principal, const Entry* without) const {
    DiskUse use;
    for (const auto& [name, entry] : entries_)
        if (entry.owner == principal && &entry != without) use.add(entry);
    return use;
}

DiskRoom SceneStore::room_for(const Entry* changed, const std::string& owner) const {
    const std::uint64_t bytes_max = quotas_.of(owner).disk_bytes;
    DiskUse use = disk_use(owner, changed);
    const std::uint64_t others = use.bytes + claims_.of(owner).disk_bytes;
    return {bytes_max - std::min(bytes_max, others), owner,
            quotas_.limit_text(owner, &Quota::disk_bytes) + "; " +
                remedy(owner, quotas_.remedy(owner, &Quota::disk_bytes), Short::names_or_disk),
            std::move(use.blobs)};
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
    // A clock that was set back or forth makes no scene unused for longer than a year.
    const auto then = [this, wall = wall_ms()](std::int64_t used_ms) {
        constexpr std::int64_t most = 366LL * 24 * 3600 * ms_of_second;
        return now_() - std::chrono::milliseconds(used_ms >= wall         ? 0
                                                  : used_ms < wall - most ? most
                                                                          : wall - used_ms);
    };
    for (std::size_t i = 0; i < state.found().size(); ++i) {
        const StoredScene& row = state.found()[i];
        Entry entry = stored_entry(row, state.found_edits()[i], state.pin(row.digest));
        entry.from_before = true;
        const auto use = state.found_uses().find(row.number);
        entry.used =
            then(use != state.found_uses().end() ? use->second.used_ms : row.used * ms_of_second);
        entry.pinned = use != state.found_uses().end() && use->second.pinned;
        entries_.emplace(row.name, std::move(entry));
    }
}

SceneStore::Entry SceneStore::stored_entry(const StoredScene& row, const KeptEdits& edits,
                                           BlobPin blob) const {
    Entry entry;
    entry.scene.name = row.name;
    entry.scene.epoch = row.epoch;
    entry.scene.build_seconds = row.build_seconds;
    // An older release did not note the content: the blob's digest stands for it.
    entry.facts = {row.content.empty() ? row.digest : row.content, row.digest, row.bytes,
                   row.instanced_triangles};
    entry.blob = std::move(blob);
    entry.stored = row;
    entry.edits = edits.count;
    entry.edit_bytes = edits.bytes;
    entry.epoch_reserved = std::max(row.epoch, edits.epoch_last);
    entry.epoch_free = entry.epoch_reserved + 1;
    if (edits.count != 0) {
        entry.scene.epoch = edits.last.epoch;
        entry.facts = {edits.last.digest, fmt::format("{} at {}", row.number, edits.last.epoch),
                       edits.last.bytes, edits.last.instanced_triangles};
    }
    entry.owner = row.owner;
    // A list on the disk comes back, also without room for it.
    if (auto share = charge_list(row.share, row.owner)) entry.stored.share = std::move(*share);
    entry.share = entry.stored.share;
    entry.kept = true;
    entry.loaded = entry.used = now_();
    return entry;
}

SceneStore::Place SceneStore::place_for(const StoredScene& row) const {
    const Entry* const entry = own_entry(row.name, {row.owner});
    if (entry == nullptr) return {};
    return {entry->damage.empty() ? Place::State::taken : Place::State::damaged, entry->stored,
            entry->edits_damaged, std::max(entry->next_epoch(), entry->epoch_reserved + 1)};
}

void SceneStore::adopt(const ReturningScene& scene) {
    Entry entry = stored_entry(scene.new_row(), scene.new_edits(), scene.blob);
    if (const Entry* const damaged = own_entry(scene.row.name, {scene.row.owner})) {
        entry.holders = damaged->holders;
        entry.pinned = damaged->pinned;
        const auto [first, last] = entries_.equal_range(scene.row.name);
        entries_.erase(
            std::find_if(first, last, [&](const auto& known) { return &known.second == damaged; }));
    }
    entries_.emplace(scene.row.name, std::move(entry));
}

void SceneStore::mend(const std::set<std::string>& digests) {
    for (auto& [name, entry] : entries_)
        if (!entry.damage.empty() && !entry.edits_damaged && !entry.scene.held &&
            digests.contains(entry.stored.digest))
            entry.damage.clear();
}

std::vector<SceneUse> SceneStore::take_uses() {
    std::vector<SceneUse> uses;
    for (auto& [name, entry] : entries_) {
        if (entry.stored.number == 0) continue;
        const auto idle =
            std::chrono::duration_cast<std::chrono::milliseconds>(now_() - entry.used);
        SceneUse use{entry.stored.number, wall_ms() - idle.count(), entry.pinned};
        // The two clocks differ a little from time to time.
        constexpr std::int64_t noise = 50;
        const auto& told = entry.told;
        if (told && told->number == use.number && told->pinned == use.pinned &&
            use.used_ms - told->used_ms < noise)
            continue;
        entry.told = use;
        uses.push_back(use);
    }
    return uses;
}

std::vector<AsleepScene> SceneStore::pinned_asleep() const {
    std::vector<AsleepScene> found;
    for (const auto& [name, entry] : entries_)
        if (entry.pinned && !entry.scene.held && entry.damage.empty())
            found.push_back(asleep_scene(entry));
    return found;
}

AsleepScene SceneStore::asleep_scene(const Entry& entry) {
    StoredScene row = entry.stored;
    // Its name was unloaded while it was on the disk alone: connections hold its blob.
    if (row.number == 0) row.digest = entry.facts.arena, row.bytes = entry.facts.bytes;
    const bool has_edits = entry.facts.arena != row.digest;
    return {entry.facts, entry.owner, std::move(row), has_edits};
}

protocol::Error SceneStore::asleep(const Entry& entry) const {
    if (!entry.damage.empty())
        return {Code::scene_invalid,
                "the stored copy of scene '" + entry.scene.name + "' is damaged: " + entry.damage +
                    "; `Load` it again, or `Unload` it",
                0};
    asleep_ = asleep_scene(entry);
    return {Code::busy, "scene '" + entry.scene.name + "' is read from the disk; ask again", 0};
}

std::optional<AsleepScene> SceneStore::take_asleep() {
    return std::exchange(asleep_, std::nullopt);
}

Reply<void> SceneStore::wake(std::shared_ptr<const Snapshot> snapshot, const AsleepScene& scene) {
    forget_freed();
    auto held = hold(std::move(snapshot), scene.owner);
    if (!held) return tl::unexpected(held.error());
    for (auto& [name, entry] : entries_) {
        if (entry.facts.arena != scene.facts.arena || entry.scene.held) continue;
        entry.scene.held = *held;
        entry.unsettle();
        entry.facts.digest = entry.scene.snapshot().digest();
        entry.damage.clear();
        if (entry.stored.number == 0) entry.blob.reset();
    }
    settle_charges();
    return {};
}

std::vector<std::string> SceneStore::quarantine(const std::string& arena, const BlobFault& fault) {
    std::vector<std::string> names;
    for (auto& [name, entry] : entries_) {
        if (entry.facts.arena != arena || entry.scene.held) continue;
        entry.damage = fault.why;
        entry.edits_damaged = fault.of_edits;
        names.push_back(entry.owner + "/" + name);
    }
    return names;
}

void SceneStore::make_room_in_quota(std::uint64_t bytes, const std::string& principal) {
    const std::uint64_t bytes_max = quotas_.of(principal).scene_bytes;
    std::uint64_t held = charged_to(principal, true).bytes + charged_to(principal, false).bytes;
    const auto beyond_quota = [&] { return bytes <= bytes_max && held > bytes_max - bytes; };
    if (!beyond_quota()) return;
    for (Droppable& scene : droppable(principal)) {
        if (!beyond_quota()) break;
        if (scene.charged_bytes == 0 || !scene.may_go()) continue;
        scene.let_go();
        held -= scene.charged_bytes;
    }
}

void SceneStore::make_room(std::uint64_t bytes, const std::string& principal,
                           std::uint64_t requests) {
    if (bytes > most_room(principal, requests)) return;
    make_room_in_quota(bytes, principal);
    const auto fits = [&] { return bytes <= budget_.room(principal, Use::lasting); };
    if (fits()) return;
    for (Droppable& scene : plan_room(principal).scenes) {
        if (fits()) break;
        scene.let_go();
    }
}

void SceneStore::make_all_room(const std::string& principal) {
    for (Droppable& scene : plan_room(principal).scenes) scene.let_go();
}

std::uint64_t SceneStore::most_room(const std::string& principal, std::uint64_t requests) {
    Budget::Freed freed = plan_room(principal).freed;
    freed.requests = requests;
    return budget_.room(principal, Use::lasting, freed);
}

SceneStore::RoomPlan SceneStore::plan_room(const std::string& principal) {
    std::vector<Droppable> scenes = droppable(principal);
    std::erase_if(scenes, [](const Droppable& scene) { return !scene.may_go(); });
    const auto payer_of = [](const Droppable& scene) { return scene.held().lease.principal(); };
    std::ranges::stable_partition(
        scenes, [&](const Droppable& scene) { return payer_of(scene) == principal; });
    RoomPlan plan;
    std::uint64_t own = budget_.held_by(principal);
    std::map<std::string, std::uint64_t> others;
    for (Droppable& scene : scenes) {
        const std::string payer = payer_of(scene);
        const std::uint64_t bytes = scene.held().lease.bytes();
        if (payer == principal) {
            own -= std::min(own, bytes);
            plan.freed.own += bytes;
        } else {
            std::uint64_t& theirs = others.try_emplace(payer, budget_.held_by(payer)).first->second;
            // Nobody gives way to a principal that holds more.
            if (theirs <= own) continue;
            theirs -= std::min(theirs, bytes);
        }
        if (!scene.is_used()) plan.freed.lasting += bytes;
        plan.scenes.push_back(std::move(scene));
    }
    return plan;
}

std::vector<SceneStore::Droppable> SceneStore::droppable(const std::string& principal) {
    std::vector<Droppable> scenes;
    std::map<const HeldScene*, std::size_t> places;
    for (auto& [name, entry] : entries_) {
        if (entry.scene.held == nullptr || entry.blob == nullptr || entry.pinned) continue;
        const auto [place, is_new] = places.emplace(entry.scene.held.get(), scenes.size());
        if (is_new) scenes.emplace_back();
        Droppable& scene = scenes[place->second];
        scene.used = std::max(scene.used, entry.used);
        scene.charged_bytes += entry.charge(principal);
        scene.entries.push_back(&entry);
    }
    std::ranges::stable_sort(scenes, {}, &Droppable::used);
    return scenes;
}

bool SceneStore::Droppable::is_used() const {
    // Jobs, other names, and edits that may take the memory refer to it, too.
    return entries.front()->scene.held.use_count() != static_cast<long>(entries.size());
}

bool SceneStore::Droppable::may_go() const {
    if (!is_used()) return true;
    // Requests of others do not keep it at the expense of those who are charged for it. They are
    // charged for what they read, even beyond their share, and give way for it.
    const auto is_any = [](const std::string&) { return true; };
    const auto is_charged = [&](const std::string& principal) {
        return std::ranges::any_of(
            entries, [&](const Entry* entry) { return entry->charged_to(principal); });
    };
    return held().reader(is_any) != nullptr && held().reader(is_charged) == nullptr;
}

void SceneStore::Droppable::let_go() {
    const std::shared_ptr<const HeldScene> held = entries.front()->scene.held;
    for (Entry* const entry : entries) entry->scene.held.reset();
    if (held.use_count() != 1) leave_to_readers(*held);
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

std::size_t SceneStore::asleep_of(const std::string& owner) const {
    return static_cast<std::size_t>(std::ranges::count_if(entries_, [&](const auto& known) {
        const Entry& entry = known.second;
        return entry.listed && entry.owner == owner && !entry.scene.held;
    }));
}

std::uint64_t SceneStore::bytes() const {
    std::uint64_t sum = 0;
    for (const auto& [digest, held] : by_arena_)
        if (const auto scene = held.lock()) sum += scene->lease.bytes();
    for (const auto& [pages, lease] : shared_leases_)
        if (const auto held = lease.lock()) sum += held->bytes();
    return sum;
}

SceneStore::Total SceneStore::charged_to(const std::string& principal, bool listed) const {
    Total total;
    for (const auto& [name, entry] : entries_) {
        if (entry.listed != listed || !entry.charged_to(principal)) continue;
        ++total.scenes;
        total.bytes += entry.charge(principal);
    }
    return total;
}

std::map<std::string, SceneStore::Usage> SceneStore::usage_of(
    const std::vector<std::string>& principals) const {
    std::map<std::string, Usage> all;
    for (const std::string& principal : principals) all[principal] = {};
    std::map<std::string_view, DiskUse> disk;
    for (const auto& [name, entry] : entries_) {
        const auto charge = [&all, &entry = entry](const std::string& principal) {
            const auto usage = all.find(principal);
            if (usage == all.end()) return;
            ++usage->second.scenes;
            usage->second.bytes += entry.charge(principal);
        };
        if (entry.kept) charge(entry.owner);
        for (const auto& [holder, connections] : entry.holders)
            if (!entry.kept || holder != entry.owner) charge(holder);
        if (all.contains(entry.owner)) disk[entry.owner].add(entry);
    }
    for (const auto& [owner, use] : disk) all[std::string(owner)].disk_bytes = use.bytes;
    return all;
}

std::uint64_t SceneStore::stored_bytes() const {
    DiskUse use;
    for (const auto& [name, entry] : entries_) use.add(entry);
    return use.bytes;
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
