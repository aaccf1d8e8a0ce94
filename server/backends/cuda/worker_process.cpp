#include "server/backends/cuda/worker_process.h"

#include "engine/packs/load.h"
#include "engine/scene/checks/arena_check.h"
#include "server/backends/cuda/channel.h"
#include "server/backends/cuda/scene_cache.h"
#include "server/backends/cuda/scene_changes.h"
#include "server/backends/cuda/wire.h"

#include <unistd.h>

#include <algorithm>
#include <span>
#include <string>
#include <thread>
#include <vector>

namespace raynest::server::device {
namespace {

/// Share of the device's memory for scenes; the rest is for slots and other users of the device.
constexpr double scenes_share = 0.8;

Ready describe(const DevicePack& from, std::string_view name) {
    Ready ready;
    ready.ok = true;
    ready.text = Text<256>(name);
    const auto variants = std::span(from.pack->variants, from.pack->variant_count);
    for (const PackVariant& variant :
         variants.first(std::min<std::size_t>(variants.size(), variants_max))) {
        VariantInfo& to = ready.variants[ready.variant_count++];
        to.name = Text<64>(variant.name);
        to.params = fingerprint({variant.params, variant.param_count});
        for (std::uint32_t query = 0; query < query_count; ++query) {
            const auto& functions = variant.trace[traversal_single];
            if (functions[query][0] != nullptr) to.queries |= 1U << query;
        }
    }
    for (const PackPrimitive& primitive :
         std::span(from.pack->primitives, from.pack->primitive_count)) {
        if (ready.record_type_count < record_types_max)
            ready.record_types[ready.record_type_count++] = primitive_type(primitive.name);
    }
    return ready;
}

/// Answers the requests of one slot.
class SlotServer {
public:
    SlotServer(const DevicePack& pack, DeviceSceneCache& scenes, DeviceSlot* slot,
               const SlotShape& shape, SlotMemory memory, Channel channel)
        : pack_(pack),
          scenes_(scenes),
          slot_(slot),
          shape_(shape),
          memory_(memory),
          channel_(std::move(channel)) {}

    /// Serves until the daemon closes the channel. After a device fault every answer says `lost`;
    /// the daemon learns the reason from it and kills the process.
    void serve() {
        for (;;) {
            Request request;
            std::vector<Fd> files;
            if (channel_.receive(request, Channel::for_ever, &files) != Received::message) return;
            channel_.send(answer(request, files));
        }
    }

private:
    Outcome answer(const Request& request, const std::vector<Fd>& files) {
        if (request.order == Order::trace) return trace(request);
        if (files.size() != 1) return refuse("a scene comes as one file");
        const Mapping file(files.front(), Mapping::Access::read);
        if (file.bytes().empty()) return refuse("the scene's memory cannot be mapped");
        return request.order == Order::load ? load(request, file.bytes())
                                            : load_changed(request, file.bytes());
    }

    Outcome load(const Request& request, std::span<const std::byte> arena) {
        const auto scene = check_arena(arena);
        if (!scene) return refuse(scene.error().message);
        return outcome_of(scenes_.load(request.scene.view(), *scene));
    }

    Outcome load_changed(const Request& request, std::span<const std::byte> file) {
        const auto ranges = read_changes(file);
        if (!ranges) return refuse(ranges.error().message);
        const DeviceSceneCache::Use base = scenes_.find(request.base.view());
        if (base.scene() == nullptr) return {Verdict::unknown_scene, {}};
        return outcome_of(scenes_.load_changed(request.scene.view(), *base.scene(), *ranges));
    }

    Outcome trace(const Request& request) {
        const TraceFunction kernel = kernel_of(request);
        if (kernel == nullptr) return refuse("there is no such kernel");
        const std::uint64_t hits = std::uint64_t{request.ray_count} * request.hits_max;
        if (request.ray_count > shape_.rays_max || hits > shape_.hits_max)
            return refuse("the call does not fit its slot");
        const DeviceSceneCache::Use use = scenes_.find(request.scene.view());
        if (use.scene() == nullptr) return {Verdict::unknown_scene, {}};

        TraceCall call{};
        call.params = request.has_params ? request.params : nullptr;
        call.rays = memory_.rays;
        call.ray_count = request.ray_count;
        call.hits_max = request.hits_max;
        call.mask = request.mask;
        call.flags = request.flags;
        call.hits = memory_.hits;
        call.hit_counts = memory_.hit_counts;
        const auto run = [&] {
            const TraceStatus status = pack_.device->start(
                slot_, use.scene(), kernel, &call, request.has_made ? &request.made : nullptr);
            return status == trace_ok ? pack_.device->finish(slot_) : status;
        };
        TraceStatus status = run();
        while (status == trace_out_of_memory && scenes_.evict_one()) status = run();
        return outcome_of(status);
    }

    [[nodiscard]] TraceFunction kernel_of(const Request& request) const {
        if (request.variant >= pack_.pack->variant_count || request.query >= query_count)
            return nullptr;
        const PackVariant& variant = pack_.pack->variants[request.variant];
        if (variant.param_count > params_max) return nullptr;
        return variant.trace[traversal_single][request.query][0];
    }

    static Outcome refuse(std::string_view why) { return {Verdict::refused, Text<256>(why)}; }

    Outcome outcome_of(TraceStatus status) const {
        switch (status) {
            case trace_ok:
                return {Verdict::done, {}};
            case trace_out_of_memory:
                return {Verdict::out_of_memory, Text<256>(std::string("out of device memory (") +
                                                          pack_.device->error() + ")")};
            case trace_cancelled:
                return {Verdict::out_of_memory, Text<256>(pack_.device->error())};
            case trace_too_deep:
                return {Verdict::too_deep, {}};
            case trace_no_device:
                return {Verdict::lost, Text<256>(pack_.device->error())};
            case trace_bad_call:
                break;
        }
        return refuse("the device refused its call");
    }

    const DevicePack& pack_;
    DeviceSceneCache& scenes_;
    DeviceSlot* const slot_;
    const SlotShape shape_;
    const SlotMemory memory_;
    Channel channel_;
};

int end(Channel& control, std::string_view why, bool absent = false) {
    Ready ready;
    ready.absent = absent;
    ready.text = Text<256>(why);
    control.send(ready);
    return 1;
}

}  // namespace

int run_worker_process(const char* path) {
    Channel control{Fd(first_inherited_fd)};
    Hello hello;
    std::vector<Fd> files;
    if (control.receive(hello, Channel::for_ever, &files) != Received::message) return 1;
    if (!bind_to_parent(hello.parent)) return 1;
    if (hello.slots > slots_max || files.size() != 1 + hello.slots) return 1;
    const Mapping memory(files.front(), Mapping::Access::share);
    if (memory.bytes().size() != hello.slots * hello.shape.bytes())
        return end(control, "the memory of the slots cannot be mapped");

    const auto pack = load_device_pack(path);
    if (!pack) return end(control, pack.error().message, true);
    const Device& device = *pack->device;
    DeviceInfo info{};
    if (device.open(&info) != trace_ok) return end(control, device.error(), info.absent);
    // Go on without pinned memory: copies are slower but correct.
    std::string name(info.name);
    if (device.pin(memory.bytes().data(), memory.bytes().size()) != trace_ok)
        name += std::string(" (memory not pinned: ") + device.error() + ")";
    DeviceSceneCache scenes(
        device, static_cast<std::uint64_t>(scenes_share * static_cast<double>(info.memory_bytes)));
    std::vector<SlotServer> servers;
    for (std::uint32_t i = 0; i < hello.slots; ++i) {
        DeviceSlot* slot = nullptr;
        if (device.make_slot(hello.shape.rays_max, hello.shape.hits_max, &slot) != trace_ok)
            return end(control, device.error());
        servers.emplace_back(*pack, scenes, slot, hello.shape,
                             SlotMemory(memory.bytes().data(), hello.shape, i),
                             Channel(std::move(files[1 + i])));
    }
    if (!control.send(describe(*pack, name))) return 1;
    std::vector<std::thread> threads;
    for (SlotServer& server : servers) threads.emplace_back([&server] { server.serve(); });
    Hello nothing;
    (void)control.receive(nothing, Channel::for_ever);
    // Do not join the threads: the daemon is gone or has dropped this process.
    ::_exit(0);
}

}  // namespace raynest::server::device
