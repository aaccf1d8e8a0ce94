#include "server/store/scene_store.h"

#include <utility>

namespace raynest::server {

Reply<std::shared_ptr<const HeldScene>> SceneStore::hold(std::shared_ptr<const Snapshot> snapshot) {
    std::weak_ptr<const HeldScene>& known = by_hash_[snapshot->hash()];
    if (auto held = known.lock()) return held;

    const std::uint64_t bytes = snapshot->bytes().size();
    auto lease = budget_.reserve(bytes);
    if (!lease)
        return refuse(Code::resource_exhausted,
                      "the scene takes " + std::to_string(bytes) + " bytes, " +
                          std::to_string(budget_.limit() - budget_.used()) +
                          " of --memory are free; unload a scene or start raynestd with more");
    auto held =
        std::make_shared<const HeldScene>(HeldScene{std::move(snapshot), std::move(*lease)});
    known = held;
    return held;
}

Reply<void> SceneStore::check_quota(const std::string& name, const std::string& principal,
                                    std::uint64_t bytes) const {
    std::uint64_t scenes = 0;
    std::uint64_t held = 0;
    for (const auto& [other, entry] : entries_) {
        if (other == name || !entry.principals.contains(principal)) continue;
        ++scenes;
        held += entry.scene.snapshot().bytes().size();
    }
    if (scenes >= limits_.principal_scenes_max)
        return refuse(Code::quota, principal + " holds " + std::to_string(scenes) +
                                       " scenes, the limit is principal_scenes_max = " +
                                       std::to_string(limits_.principal_scenes_max) +
                                       "; unload one");
    if (bytes > limits_.principal_scene_bytes_max ||
        held > limits_.principal_scene_bytes_max - bytes)
        return refuse(Code::quota,
                      principal + " holds " + std::to_string(held) + " bytes of scenes, " +
                          std::to_string(bytes) + " more are over principal_scene_bytes_max = " +
                          std::to_string(limits_.principal_scene_bytes_max) + "; unload one");
    return {};
}

Reply<NamedScene> SceneStore::publish(const std::string& name,
                                      std::shared_ptr<const Snapshot> snapshot, bool replace,
                                      const std::string& principal) {
    std::erase_if(by_hash_, [](const auto& known) { return known.second.expired(); });

    const auto found = entries_.find(name);
    const bool taken = found != entries_.end();
    if (const auto quota = check_quota(name, principal, snapshot->bytes().size()); !quota)
        return tl::unexpected(quota.error());
    if (taken && found->second.scene.snapshot().hash() == snapshot->hash()) {
        found->second.principals.insert(principal);
        return found->second.scene;
    }
    if (taken && !replace)
        return refuse(Code::name_taken, "another scene is called '" + name +
                                            "'; load this one with --name NAME, or put it in the "
                                            "other's place with --replace");
    // Whoever else holds it would find another scene, charged to its own quota.
    if (taken &&
        (found->second.principals.size() > 1 || !found->second.principals.contains(principal)))
        return refuse(Code::not_allowed, "scene '" + name +
                                             "' is held by others too; load this one with "
                                             "--name NAME");
    auto held = hold(std::move(snapshot));
    if (!held) return tl::unexpected(held.error());

    // Complete before it is in the table, so that lack of memory leaves what was there.
    Entry entry = taken ? found->second : Entry();
    entry.scene.name = name;
    entry.scene.held = std::move(*held);
    ++entry.scene.epoch;
    entry.principals.insert(principal);
    NamedScene scene = entry.scene;
    entries_.insert_or_assign(name, std::move(entry));
    return scene;
}

bool SceneStore::holds(const std::string& hash) const {
    const auto known = by_hash_.find(hash);
    return known != by_hash_.end() && !known->second.expired();
}

Reply<NamedScene> SceneStore::find(std::string_view name, std::uint64_t epoch) const {
    const auto found = entries_.find(name);
    if (found == entries_.end())
        return refuse(Code::scene_unknown, "scene '" + std::string(name) +
                                               "' is not loaded; run: raynest load FILE --name " +
                                               std::string(name));
    const NamedScene& scene = found->second.scene;
    if (epoch != 0 && epoch != scene.epoch)
        return refuse(Code::scene_unknown, "scene '" + scene.name + "' is at epoch " +
                                               std::to_string(scene.epoch) + ", not " +
                                               std::to_string(epoch) + "; ask without --epoch");
    return scene;
}

Reply<bool> SceneStore::unload(std::string_view name, const std::string& principal) {
    const auto found = entries_.find(name);
    if (found == entries_.end())
        return refuse(Code::scene_unknown,
                      "scene '" + std::string(name) + "' is not loaded; run: raynest scenes");
    if (found->second.principals.erase(principal) == 0)
        return refuse(Code::not_allowed, "scene '" + std::string(name) +
                                             "' was loaded by others; only they unload it");
    const bool last = found->second.principals.empty();
    if (last) entries_.erase(found);
    return last;
}

std::vector<NamedScene> SceneStore::list() const {
    std::vector<NamedScene> scenes;
    scenes.reserve(entries_.size());
    for (const auto& [name, entry] : entries_) scenes.push_back(entry.scene);
    return scenes;
}

}  // namespace raynest::server
