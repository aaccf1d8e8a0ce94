#include "server/execution/selected.h"

#include <chrono>
#include <thread>
#include <utility>

namespace raynest::server {

Selected::Selected(SelectionWords words, std::uint64_t instances_max, Budget& budget,
                   std::string principal, Budget::Lease lease)
    : words_(std::move(words)),
      instances_max_(instances_max),
      budget_(budget),
      principal_(std::move(principal)),
      lease_(std::move(lease)),
      bytes_(lease_.bytes()) {}

std::uint64_t Selected::least_bytes(const SceneView& scene, const SelectionWords& words) {
    const InstanceLists none;
    std::uint64_t bytes = SelectedInstances::size(scene, none.selection(), words.skips_boxes).bytes;
    // The text of each outermost instance is compared, and each may be found.
    if (!words.hidden.texts.empty() || !words.only.texts.empty())
        bytes += scene.objects[scene.root].instance_count * search_bytes_per_instance;
    return bytes;
}

Reply<void> Selected::make(const Snapshot& scene, const Stop& stop) {
    std::unique_lock lock(making_, std::try_to_lock);
    while (!lock) {  // another job makes it
        if (stop.requested()) return refuse(Code::cancelled, "");
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
        (void)lock.try_lock();
    }
    if (is_made()) return {};
    auto made = make_now(scene, stop);
    state_ = made ? State::made : State::failed;
    return made;
}

Reply<void> Selected::make_now(const Snapshot& scene, const Stop& stop) {
    InstanceLists lists = words_.lists;
    const auto found = find_parts(
        scene, words_.hidden, words_.only, [&stop] { return stop.requested(); }, lists);
    if (stop.requested()) return refuse(Code::cancelled, "");
    if (!found) return refuse(found.error());
    const SelectedInstances::Size size =
        SelectedInstances::size(scene.view(), lists.selection(), words_.skips_boxes);
    if (size.instances > instances_max_)
        return refuse(Code::limit_exceeded,
                      "to hide parts of shared objects takes copies of more instances than "
                      "hidden_instances_max = " +
                          std::to_string(instances_max_) + ": name what stands above them");
    // Each part has a way of its own, and each way a branch.
    constexpr std::uint64_t part_bytes = 1024;
    const std::uint64_t wanted =
        size.bytes + part_bytes * (lists.hidden_parts.size() + lists.only_parts.size());
    if (wanted > lease_.bytes()) {
        const std::uint64_t more_bytes = wanted - lease_.bytes();
        auto more = budget_.reserve(more_bytes, principal_);
        if (!more) return budget_.refuse("hiding parts", more_bytes, principal_, "hide fewer");
        lease_.merge(std::move(*more));
    }
    instances_.emplace(scene.view(), lists.selection(), words_.skips_boxes);
    lease_.shrink(size.bytes);
    bytes_ = size.bytes;
    return {};
}

void Selected::name_by_scene(std::span<HitRecord> hits) const {
    if (!has_copies()) return;
    for (HitRecord& hit : hits) hit.object = instances_->object_in_scene(hit.object);
}

Step Selected::in_scene(Step step) const {
    step.object = instances_->object_in_scene(step.object);
    if (step.kind == step_instance) step.place = instances_->instance_in_scene(step.place);
    return step;
}

}  // namespace raynest::server
