#include "server/backends/cuda/upload.h"

#include "server/backends/cuda/refusals.h"
#include "server/backends/cuda/scene_changes.h"

#include <algorithm>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

namespace raynest::server::device {
namespace {

using std::chrono::milliseconds;

/// Most scenes that a process is known to have been given. Edits make new ones without end.
constexpr std::size_t given_max = 1024;

/// Returns a bound on the bytes of the trees that the worker makes of a scene before it uploads
/// them: 384 bytes per leaf block instead of 320, 96 per node instead of 256 (cuda/device_tree.h).
constexpr std::uint64_t compressed_bytes_max(std::uint64_t scene_bytes) {
    return scene_bytes + scene_bytes / 5;
}

/// Assumed speed of an upload. One core copies, checks and compresses a scene at 360 MB/s (terrain
/// of 2 million triangles, fake device); a fifth of that leaves room for a busy machine.
constexpr std::uint64_t loaded_bytes_per_ms = 70'000;

/// Asks the worker to load a scene from a memory file of so many bytes, which `write(file)` writes.
template <class Write>
tl::expected<Outcome, Unavailable> hand_over(Process& process, std::uint32_t slot,
                                             const Request& request, std::uint64_t bytes,
                                             const UploadContext& context, Write write) {
    const auto lease = context.budget.reserve(bytes + compressed_bytes_max(bytes));
    if (!lease)
        return tl::unexpected(
            no_room("handing the scene over needs more memory than --memory has left"));
    const auto file = create_memory_file("raynest-device-scene");
    if (!file) return tl::unexpected(Unavailable{file.error().message});
    if (const auto written = write(file->get()); !written)
        return tl::unexpected(Unavailable{written.error().message});
    context.metrics.cuda_upload_bytes += bytes;
    const int files[] = {file->get()};
    const auto outcome = process.ask(slot, request, load_time_max(context.limits, bytes), files);
    if (!outcome) return tl::unexpected(lost(outcome.error().message));
    return *outcome;
}

/// Sends what edits have changed since a scene that the process was given. Returns nothing where
/// there is none, or where the worker does not answer `done`: it may have evicted that scene, or
/// lack the room for both.
std::optional<tl::expected<Outcome, Unavailable>> upload_changes(Process& process,
                                                                 std::uint32_t slot,
                                                                 const Snapshot& scene,
                                                                 const UploadContext& context) {
    std::set<std::string>& given = process.given();
    const auto base = scene.edited_from([&](const std::string& id) { return given.contains(id); });
    if (!base) return std::nullopt;
    const std::vector<RangeHead> ranges = changed_ranges(scene.bytes(), base->changed);
    if (ranges.size() > changed_ranges_max) return std::nullopt;
    Request request;
    request.order = Order::load_changed;
    request.scene = SceneText(scene.arena_id());
    request.base = SceneText(base->arena_id);
    auto outcome = hand_over(process, slot, request, changes_bytes(ranges), context, [&](int file) {
        const std::vector<std::byte> changes = changes_file(scene.bytes(), ranges);
        return write_all(file, changes.data(), changes.size());
    });
    if (!outcome || outcome->verdict == Verdict::done || outcome->verdict == Verdict::lost)
        return outcome;
    if (outcome->verdict == Verdict::unknown_scene) given.erase(base->arena_id);
    return std::nullopt;
}

tl::expected<Outcome, Unavailable> upload_whole(Process& process, std::uint32_t slot,
                                                const Snapshot& scene,
                                                const UploadContext& context) {
    Request request;
    request.order = Order::load;
    request.scene = SceneText(scene.arena_id());
    // The arena cannot lie in a memory file from the start: traversal gains 2 to 9 % from huge
    // pages (bvh/pages.h), which memory files lack by default.
    const auto bytes = scene.bytes();
    return hand_over(process, slot, request, bytes.size(), context,
                     [&](int file) { return write_all(file, bytes.data(), bytes.size()); });
}

}  // namespace

milliseconds load_time_max(const protocol::Limits& limits, std::uint64_t scene_bytes) {
    return milliseconds(std::min(limits.cuda_start_ms_max,
                                 limits.cuda_call_ms_max + scene_bytes / loaded_bytes_per_ms));
}

tl::expected<Outcome, Unavailable> upload(Process& process, std::uint32_t slot,
                                          const Snapshot& scene, const UploadContext& context) {
    std::set<std::string>& given = process.given();
    given.erase(scene.arena_id());
    auto outcome = upload_changes(process, slot, scene, context);
    if (!outcome) outcome = upload_whole(process, slot, scene, context);
    if (*outcome && (*outcome)->verdict == Verdict::done) {
        if (given.size() >= given_max) given.clear();
        given.insert(scene.arena_id());
    }
    return std::move(*outcome);
}

}  // namespace raynest::server::device
