// The scenes that the daemon holds, by owner and name.
//
// A name belongs to the principal that loaded the scene: two owners may each have `car`. Other
// principals see a scene only if it is shared with them, as OWNER/car, or as car where that means
// one scene only. A scene that a caller may not see is, for it, one that does not exist.
//
// A scene is immutable; jobs keep the one they started with. A scene stays while it has references:
// its name, unless it was loaded as temporary, and one for each open connection that loaded or
// opened it. Unloading drops the name and the reference of the caller's connection. The name is
// then free; connections that still hold the scene can go on using it. Replacing a name's content
// publishes a new epoch for all holders. The last reference frees the memory.
//
// A holder is charged for the content that it opened, the owner for what stands there now. Once the
// owner has let go of a scene, those who opened less than there is now lose it.
#pragma once

#include "protocol/limits.h"
#include "server/ground/budget.h"
#include "server/ground/errors.h"
#include "server/security/caller.h"
#include "server/security/quotas.h"
#include "server/store/disk_room.h"
#include "server/store/named_scene.h"
#include "server/store/publication.h"
#include "server/store/share_list.h"
#include "server/store/state_folder.h"

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::server {

/// The table of scenes. Io thread only.
class SceneStore {
public:
    using Clock = std::chrono::steady_clock;
    using Now = std::function<Clock::time_point()>;

    /// The quotas are principal_scenes_max and principal_scene_bytes_max.
    explicit SceneStore(Budget& budget, const protocol::Limits& limits = {}, Now now = Clock::now)
        : budget_(budget),
          limits_(limits),
          quotas_(limits),
          now_(std::move(now)) {}

    /// Frees memory of a scene, which may take seconds; its bytes have been returned to the budget.
    /// Called on any thread.
    using Dispose = std::function<void(std::shared_ptr<const void>)>;
    /// Call it while no job runs: before the first scene, and with an empty function at the end.
    void set_disposal(Dispose dispose) { *dispose_ = std::move(dispose); }

    /// Returns a scene that no name has: with its last reference its memory goes as that of others.
    [[nodiscard]] std::shared_ptr<const HeldScene> with_memory(HeldScene scene) const;

    /// Changes the limits; scenes beyond them stay.
    void set_limits(const protocol::Limits& limits) {
        limits_ = limits;
        quotas_.set_limits(limits);
    }
    /// Quotas that differ from the default limits, by principal.
    [[nodiscard]] Quotas& quotas() { return quotas_; }

    /// Returns the number of a new connection.
    [[nodiscard]] std::uint64_t connect() { return ++last_connection_; }
    /// Drops the references of a connection that has ended. Idempotent; allocates no memory.
    void disconnect(const ConnectionId& caller) noexcept;

    /// Checks that the caller's principal may hold a scene of `bytes` under this name, besides its
    /// others. Otherwise fails with QUOTA and proposes what to unload.
    [[nodiscard]] Reply<void> check_quota(std::string_view name, const ConnectionId& caller,
                                          std::uint64_t bytes) const;

    /// Publishes a snapshot under a name of the caller's, and gives its connection a reference to
    /// it. Equal content under the same name keeps its epoch. Different content fails with
    /// NAME_TAKEN unless `how.replace`. Fails with QUOTA beyond the principal's quota, and with
    /// RESOURCE_EXHAUSTED if the budget has no room. Equal content under two names is stored once,
    /// whoever owns them. A stored scene is at the epoch of its row, which must not be outdated.
    Reply<NamedScene> publish(const std::string& name, std::shared_ptr<const Snapshot> snapshot,
                              Publication how, const ConnectionId& caller);

    /// A row that must be committed before publish() may publish its scene.
    struct Stored {
        StoredScene row;
        std::unique_ptr<StoredScene> before;  ///< the row in whose place it is put; null: none
        std::shared_ptr<const HeldScene> held;
        std::shared_ptr<void> claim;  ///< on disk_bytes, until the scene has its entry
    };
    /// Returns what the caller may store under this name.
    [[nodiscard]] DiskRoom disk_room(std::string_view name, const ConnectionId& caller) const;
    /// Checks all that publish() checks, and returns the row; its number is for the caller to fill
    /// in. `epochs_free` epochs before its own are left to edits that come first.
    Reply<Stored> prepare_to_store(const std::string& name,
                                   std::shared_ptr<const Snapshot> snapshot, const Publication& how,
                                   const ConnectionId& caller, std::uint64_t epochs_free = 0);
    /// True if edits have used the epoch of such a row meanwhile: it wants a later one.
    [[nodiscard]] bool is_outdated(const StoredScene& row, const ConnectionId& caller) const;
    /// True if a load of this name changes a scene that is stored, or would be without `temporary`.
    [[nodiscard]] bool is_stored(std::string_view name, const ConnectionId& caller) const;
    /// True if the scene was stored before the start and was not loaded since.
    [[nodiscard]] bool is_from_before(std::string_view name, const ConnectionId& caller) const;

    /// Enters the scenes of a state folder; they are on the disk alone.
    void adopt(StateFolder& state);
    /// What a scene of a backup finds under its owner and name.
    struct Place {
        enum class State { free, damaged, taken } state = State::free;
        StoredScene row = {};        ///< a damaged scene's
        bool edits_damaged = false;  ///< likewise: not its blob, but an edit since
        std::uint64_t epoch = 1;     ///< the first that was not told there
    };
    [[nodiscard]] Place place_for(const StoredScene& row) const;
    /// Enters one whose row has been committed, under a free name or in the place of a damaged scene;
    /// it is on the disk alone.
    void adopt(const ReturningScene& scene);
    /// These blobs are whole again: what was said of their damage is forgotten.
    void mend(const std::set<std::string>& digests);
    /// Returns the scene because of which find() has failed, once.
    [[nodiscard]] std::optional<AsleepScene> take_asleep();
    /// Brings all scenes of this content into memory. Fails as hold() does.
    Reply<void> wake(std::shared_ptr<const Snapshot> snapshot, const AsleepScene& scene);
    /// The stored content cannot be used; find() says why until somebody loads it again. Returns
    /// their names.
    std::vector<std::string> quarantine(const std::string& arena, const BlobFault& fault);
    /// Frees memory of stored scenes that nobody uses until the principal has room for `bytes`, within
    /// its quota and --memory: its own, then those of principals that hold more than it, each the least
    /// recently used first. Frees none if all of them are not enough, with `requests` bytes that
    /// requests of others could free besides.
    void make_room(std::uint64_t bytes, const std::string& principal, std::uint64_t requests = 0);
    /// Frees all memory that make_room() may free for this principal.
    void make_all_room(const std::string& principal);
    /// Returns the most that make_room() can make, once requests of others have freed `requests`.
    [[nodiscard]] std::uint64_t most_room(const std::string& principal, std::uint64_t requests = 0);
    /// The same for memory that is there already, and counts towards the quota alone.
    void make_room_in_quota(std::uint64_t bytes, const std::string& principal);
    /// Returns the rows of names that unload() has dropped since the last call.
    [[nodiscard]] std::vector<StoredScene> take_dropped() { return std::exchange(dropped_, {}); }

    /// Fails as find() does, and with NOT_ALLOWED for a scene of another owner.
    [[nodiscard]] Reply<void> may_edit(std::string_view name, const ConnectionId& caller) const;
    /// Fails with INVALID_FIELD for a scene of which nothing outlives the daemon.
    [[nodiscard]] Reply<void> may_keep(std::string_view name, bool has_state,
                                       const ConnectionId& caller);
    /// Says what must be on the disk before an edit of a scene is published. `change_bytes`: of one
    /// to be kept. Fails with QUOTA if a kept one is too much for the owner's disk_bytes. `whole`:
    /// all of the scene is stored in any case.
    [[nodiscard]] Reply<EditPlan> plan_edit(const NamedScene& before, std::uint64_t change_bytes,
                                            bool keep, bool whole, const ConnectionId& caller);
    /// Publishes what an edit made of `before` as the scene's next epoch, for all who hold it.
    /// Returns nothing if it is at another epoch meanwhile. Fails as may_edit() and publish() do;
    /// the quota is the owner's, and asked for where the scene has grown.
    Reply<std::optional<NamedScene>> publish_edit(const NamedScene& before,
                                                  std::shared_ptr<const Snapshot> edited,
                                                  const ConnectionId& caller,
                                                  EditPublication how = {});
    /// Keeps a scene in memory, or no longer, whatever make_room() lets go of. Returns its name.
    /// Fails as may_edit() does, and as find() if it is to stay there.
    Reply<std::string> pin(std::string_view name, bool pinned, const ConnectionId& caller);
    /// The edits of this row on their way to the disk have failed: what the scene is now is not
    /// kept.
    void edit_was_not_kept(std::uint64_t number);

    /// Returns the epoch before the last edit of a scene, for its memory: null if anybody else
    /// refers to it.
    std::shared_ptr<const Snapshot> take_spare(const NamedScene& of, const ConnectionId& caller);
    /// Frees the memory that is kept for edits to come.
    void drop_spares();

    /// True if this content is stored under any name or used by a running job.
    [[nodiscard]] bool holds(const std::string& hash) const;
    /// True if the caller may see a scene of this content.
    [[nodiscard]] bool shows(const std::string& hash, const ConnectionId& caller) const;

    /// Returns the scene that an upload of this digest makes, if the caller may see one; else null.
    /// Looks at every entry, so that the time does not tell of others.
    [[nodiscard]] std::shared_ptr<const HeldScene> find_made_of(const std::string& digest,
                                                                const ConnectionId& caller) const;

    /// Returns the scenes that the caller may see and that are in memory, the last used ones first,
    /// with HeldScene::part_digests.
    [[nodiscard]] std::vector<std::shared_ptr<const HeldScene>> visible_scenes(
        const ConnectionId& caller) const;

    /// Returns the scene that the caller means by a name: its own, one that it holds, or one that
    /// is shared with it. `epoch` must be 0 or the current epoch. Fails with SCENE_UNKNOWN and a
    /// remedy, in the same words and time for a scene of another owner as for none.
    [[nodiscard]] Reply<NamedScene> find(std::string_view name, std::uint64_t epoch,
                                         const ConnectionId& caller) const;
    /// As find(), for those who only read: `epoch` may also be one before an edit, as long as it is
    /// in memory because a request reads it or the next edit is to be made in its memory.
    [[nodiscard]] Reply<NamedScene> find_to_read(std::string_view name, std::uint64_t epoch,
                                                 const ConnectionId& caller);
    /// Finds several scenes at their current epochs, in one pass over all. Fails as find() does for
    /// the first of them that it does not return.
    [[nodiscard]] Reply<std::vector<NamedScene>> find_each(const std::vector<std::string>& names,
                                                           const ConnectionId& caller) const;

    /// Finds a scene as find() does, and gives the caller's connection a reference to it. Fails
    /// with QUOTA as publish() does.
    Reply<NamedScene> open(std::string_view name, const ConnectionId& caller);

    struct Unloaded {
        std::string name;
        std::vector<std::string> holders;  ///< remaining holders, as unload() returns them
    };
    /// Drops the reference of the caller's connection and, for its owner and administrators, the
    /// name; only the connection's if it loaded the scene as temporary. Returns the remaining
    /// holders, one text per principal: "uid:1000 (2 connections)". Fails with NOT_ALLOWED for a
    /// shared scene that the caller does not hold.
    Reply<std::vector<std::string>> unload(std::string_view name, const ConnectionId& caller);

    /// Unloads at most `most` scenes that the caller's principal or connection holds and that no
    /// request has used for `idle`.
    std::vector<Unloaded> unload_idle(Clock::duration idle, std::size_t most,
                                      const ConnectionId& caller);

    struct Listed {
        NamedScene scene;
        std::string owner;
        std::string share;  ///< "", "public", or a list of principals (protocol/subject.h)
        Clock::duration age{};
        Clock::duration idle{};   ///< time since a request last used the scene
        std::size_t holders = 0;  ///< number of open connections that loaded or opened the scene
        SceneFacts facts = {};
        const char* state = "";  ///< memory, pinned, disk or damaged
    };
    /// The scenes that find() can return to the caller, by name: at most `most` from number `first`
    /// on, and the number of all.
    struct Page {
        std::vector<Listed> scenes;
        std::size_t total = 0;
    };
    [[nodiscard]] Page page(const ConnectionId& caller, std::size_t first, std::size_t most) const;
    /// Returns all of these scenes.
    [[nodiscard]] std::vector<Listed> list(const ConnectionId& caller) const {
        return page(caller, 0, entries_.size()).scenes;
    }

    /// Number of scenes: listed ones, and unlisted ones, which only connections hold.
    [[nodiscard]] std::size_t size() const { return entries_.size(); }
    struct Total {
        std::size_t scenes = 0;
        std::uint64_t bytes = 0;
    };
    /// Bytes of all scenes that somebody holds, each once.
    [[nodiscard]] std::uint64_t bytes() const;
    /// Returns number and bytes of the scenes on the disk alone.
    [[nodiscard]] Total asleep() const;
    /// Returns how many of a principal's names have their scene on the disk alone.
    [[nodiscard]] std::size_t asleep_of(const std::string& owner) const;
    /// Bytes of all scenes in the state folder, kept edits among them. Two names of one content count
    /// once.
    [[nodiscard]] std::uint64_t stored_bytes() const;
    /// Returns when each stored scene was used and whether it is pinned, as far as that differs from
    /// what was returned before.
    [[nodiscard]] std::vector<SceneUse> take_uses();
    /// Returns the pinned scenes that are on the disk alone.
    [[nodiscard]] std::vector<AsleepScene> pinned_asleep() const;
    /// Returns number and bytes of the unlisted scenes.
    [[nodiscard]] Total unlisted() const;
    /// Returns number and bytes of the scenes that count towards the quotas of a principal, listed
    /// or unlisted ones.
    [[nodiscard]] Total charged_to(const std::string& principal, bool listed) const;
    /// Returns what a principal holds of the budget, as it is told: each of its scenes counts in
    /// full, whether or not others hold the same content and are charged for it.
    [[nodiscard]] std::uint64_t memory_of(const std::string& principal) const;
    /// How much of its quotas a principal has in scenes.
    struct Usage {
        std::size_t scenes = 0;
        std::uint64_t bytes = 0;
        /// In the state folder, kept edits among them. Two names of one content count once.
        std::uint64_t disk_bytes = 0;
    };
    /// Returns that of each of these principals, in one pass over all scenes.
    [[nodiscard]] std::map<std::string, Usage> usage_of(
        const std::vector<std::string>& principals) const;
    enum class Short { memory, names_or_disk };
    /// Returns advice on how to make room for scenes: to unload the principal's least recently used
    /// ones, if any help, or what raises the limit, `larger`.
    [[nodiscard]] std::string remedy(const std::string& principal, const std::string& larger,
                                     Short of = Short::memory) const;

private:
    struct Entry {
        NamedScene scene;  ///< its memory is null while the scene is on the disk alone
        SceneFacts facts;
        /// Its blob on the disk, without kept edits, and the blob's size; no digest: it has none.
        [[nodiscard]] std::pair<std::string, std::uint64_t> on_disk() const {
            if (stored.number != 0) return {stored.digest, stored.bytes};
            // Without a name, but held: its blob stays until it is read.
            if (blob != nullptr && !scene.held) return {facts.arena, facts.bytes};
            return {};
        }
        /// An older release did not note the content of what it stored.
        [[nodiscard]] bool has_content(const Snapshot& snapshot) const {
            return facts.digest == snapshot.digest() || facts.arena == snapshot.arena_id();
        }
        BlobPin blob;        ///< not null: this content is stored
        StoredScene stored;  ///< the row of this name; number 0: it has none
        /// Kept edits since that row. They lead to this content if `blob`, that of the row, is not
        /// null.
        std::uint64_t edits = 0;
        std::uint64_t edit_bytes = 0;
        /// Epochs up to this one are not told again after a restart
        std::uint64_t epoch_reserved = 0;
        std::uint64_t epoch_free = 0;  ///< the first that the daemons before have not told
        std::string damage;            ///< why the stored content cannot be used; empty: it can
        bool edits_damaged = false;    ///< then: not the blob, but an edit since
        bool pinned = false;           ///< stays in memory
        std::optional<SceneUse> told;  ///< the last of take_uses()
        bool from_before = false;      ///< stored before the start, and not loaded since
        std::string owner;             ///< the principal that loaded it
        Clock::time_point loaded;
        mutable Clock::time_point used;
        bool listed = true;  ///< true: callers find the scene by its name
        bool kept = false;   ///< true: the name is a reference; false: only connections hold it
        ShareList share;
        std::string made_of;  ///< as in Publication
        /// The epoch before the last edit. The next edit is made in its memory, if nobody reads it
        /// then.
        std::shared_ptr<const HeldScene> spare;
        /// Epochs before edits, which those who see the scene have seen; many of them are gone.
        std::map<std::uint64_t, std::weak_ptr<const HeldScene>> earlier;
        struct Hold {
            bool temporary = false;   ///< the connection loaded the scene as temporary
            std::uint64_t bytes = 0;  ///< bytes of the content that it opened
        };
        /// Connections of each principal.
        std::map<std::string, std::map<std::uint64_t, Hold>> holders;

        [[nodiscard]] bool held_by(const ConnectionId& caller) const;
        [[nodiscard]] bool temporary_of(const ConnectionId& caller) const;
        [[nodiscard]] bool visible_to(const ConnectionId& caller) const;
        /// As visible_to(), for one who is no administrator.
        [[nodiscard]] bool is_shown_to(const std::string& principal) const;
        void unsettle() const;  ///< before or after who has the entry, or sees it, changes
        /// True while the scene is its owner's, by its name or by a connection.
        [[nodiscard]] bool is_owners() const { return kept || holders.contains(owner); }
        /// True if the scene counts towards the quotas of this principal.
        [[nodiscard]] bool charged_to(const std::string& principal) const;
        /// Returns the bytes in memory that count towards the quotas of this principal: of what
        /// another owner has put in the scene's place, no more than what the principal opened.
        [[nodiscard]] std::uint64_t charge(const std::string& principal) const;
        /// After the content has become smaller: others than the owner are charged no more again.
        void lower_holds();
        /// Returns the name by which the caller finds the scene.
        [[nodiscard]] std::string name_for(const ConnectionId& caller) const;
        [[nodiscard]] NamedScene scene_for(const ConnectionId& caller) const;
        /// A row of this content; its number is for the caller to fill in.
        [[nodiscard]] StoredScene row() const;
        [[nodiscard]] std::uint64_t next_epoch() const {
            return std::max(scene.epoch + 1, epoch_free);
        }
        [[nodiscard]] std::size_t connections() const;
        /// Drops the reference of the caller's connection; true if no reference is left. Where it was
        /// the owner's last one, the holds of those who opened less than there is now end, too.
        bool release(const ConnectionId& caller) noexcept;
    };
    /// Scenes by name without owner. Of one owner and name, at most one is listed, and a connection
    /// holds at most one.
    using Entries = std::multimap<std::string, Entry, std::less<>>;

    template <class Place>
    struct Choice;
    /// Returns the entry that the caller means by this name, or the end. Looks at every entry, so
    /// that the time does not tell whether there is one that the caller may not see. `entries` may
    /// be const.
    template <class AnyEntries>
    static auto resolve(AnyEntries& entries, std::string_view name, const ConnectionId& caller);
    /// Returns the caller's own listed entry of this name, or the end.
    template <class AnyEntries>
    static auto own(AnyEntries& entries, std::string_view name, const ConnectionId& caller);
    /// Returns what resolve() does; null in place of the end.
    Entry* meant(std::string_view name, const ConnectionId& caller);
    [[nodiscard]] const Entry* own_entry(std::string_view name, const ConnectionId& caller) const;
    /// Returns what find() does for the entry that resolve() has returned.
    [[nodiscard]] Reply<NamedScene> found_at(Entries::const_iterator found, std::string_view name,
                                             std::uint64_t epoch, const ConnectionId& caller) const;
    /// Returns the error for a name that resolve() does not find: it means several scenes, or none.
    [[nodiscard]] protocol::Error not_found(std::string_view name,
                                            const ConnectionId& caller) const;
    /// Names and owners of what a caller holds; they hide listed scenes. Valid until an entry goes.
    using HeldNames = std::set<std::pair<std::string_view, std::string_view>>;
    template <class Range>
    [[nodiscard]] static HeldNames held_names(const Range& entries, const ConnectionId& caller);
    /// True if the caller finds this entry by its name: none that it holds hides it.
    [[nodiscard]] static bool found_by(const Entry& entry, const ConnectionId& caller,
                                       const HeldNames& held);
    /// Does the work of unload() but to settle the charges.
    std::vector<std::string> drop(Entries::iterator found, const ConnectionId& caller);
    Reply<void> check_quota(const Entry* changed, const std::string& principal,
                            std::uint64_t bytes) const;
    /// Fails with QUOTA if the principal's connections hold as many scenes as they may.
    [[nodiscard]] Reply<void> check_holds(const std::string& principal) const;
    struct DiskUse {
        std::uint64_t bytes = 0;
        std::set<std::string> blobs;

        void add(const Entry& entry);
    };
    /// Returns what the scenes of a principal but `without` have on the disk.
    [[nodiscard]] DiskUse disk_use(const std::string& principal, const Entry* without) const;
    /// Returns what `owner` may store in the place of `changed`.
    [[nodiscard]] DiskRoom room_for(const Entry* changed, const std::string& owner) const;
    /// Settles the charges of all contents that are unsettled, in one pass over all entries.
    void settle_charges() noexcept;
    using Sharers = std::vector<const Entry*>;  ///< all entries of one content
    /// Charges a content to another if the one that it is charged to holds it no more, and tells the
    /// budget which owners do not see who is charged.
    void settle_charge(const HeldScene& held, const Sharers& sharers);
    static Budget::Unpaid::Bytes unpaid_of(const HeldScene& held, const Sharers& sharers);
    /// Charges the memory of a scene that no name and no connection refers to, to one of those whose
    /// requests read it.
    static void leave_to_readers(const HeldScene& held) noexcept;
    /// Notes that a request of this principal reads the scene, as long as it keeps the result.
    [[nodiscard]] static NamedScene read_by(NamedScene scene, const std::string& principal);
    /// A scene in memory that can be read from the disk again.
    struct Droppable {
        Clock::time_point used = Clock::time_point::min();  ///< under any of its names
        std::uint64_t charged_bytes = 0;  ///< that count towards the principal's quota
        std::vector<Entry*> entries;

        [[nodiscard]] const HeldScene& held() const { return *entries.front()->scene.held; }
        [[nodiscard]] bool is_used() const;
        /// False if somebody uses it who is charged for it.
        [[nodiscard]] bool may_go() const;
        void let_go();
    };
    /// Returns all such scenes, the least recently used first.
    std::vector<Droppable> droppable(const std::string& principal);
    struct RoomPlan {
        std::vector<Droppable> scenes;  ///< that make_room() may let go of, in its order
        Budget::Freed freed;            ///< by all of them
    };
    RoomPlan plan_room(const std::string& principal);
    [[nodiscard]] static AsleepScene asleep_scene(const Entry& entry);
    /// Makes the entry of a stored scene that is on the disk alone.
    [[nodiscard]] Entry stored_entry(const StoredScene& row, const KeptEdits& edits,
                                     BlobPin blob) const;
    /// Returns the error for a scene on the disk alone, and remembers it for take_asleep().
    protocol::Error asleep(const Entry& entry) const;
    /// Fails with NAME_TAKEN or QUOTA if publish() may not publish this.
    Reply<void> check_publication(const std::string& name, const Snapshot& snapshot,
                                  const Publication& how, const ConnectionId& caller) const;
    /// Drops what is known of scenes and shared memory that are gone.
    void forget_freed();
    Reply<std::shared_ptr<const HeldScene>> hold(std::shared_ptr<const Snapshot> snapshot,
                                                 const std::string& principal);
    /// Returns the list with its memory charged to the principal, unless it is short.
    [[nodiscard]] Reply<ShareList> charge_list(const ShareList& list,
                                               const std::string& principal) const;

    Budget& budget_;
    protocol::Limits limits_;
    Quotas quotas_;
    const Now now_;
    /// Shared with the scenes: a job may hold one for longer than this store. Empty: a scene is
    /// freed where its last reference is dropped.
    const std::shared_ptr<Dispose> dispose_ = std::make_shared<Dispose>();
    Entries entries_;
    std::map<std::string, std::weak_ptr<const HeldScene>> by_arena_;
    std::map<const SharedPages*, std::weak_ptr<const Budget::Lease>> shared_leases_;
    Claims claims_;
    std::uint64_t last_connection_ = 0;
    std::set<std::uint64_t> holding_;  ///< connections that may hold something
    mutable std::optional<AsleepScene> asleep_;
    std::vector<StoredScene> dropped_;
};

}  // namespace raynest::server
