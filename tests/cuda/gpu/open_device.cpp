#include "tests/cuda/gpu/open_device.h"

#include "tests/bench/value_of.h"

#include <span>

namespace raynest::bench {
const Pack& open_pack(const std::string& path) {
    return *value_of(load_pack(path));
}

const PackVariant* find_variant(const Pack& pack, const std::string& name) {
    for (const PackVariant& variant : std::span(pack.variants, pack.variant_count)) {
        if (variant.name == name) return &variant;
    }
    return nullptr;
}

OpenDevice::OpenDevice(const std::string& path) : device_pack_(value_of(load_device_pack(path))) {
    if (device_pack_.device->open(&info_) != trace_ok) throw NoDevice(device_pack_.device->error());
}

OpenDevice::Scene OpenDevice::load(const SceneView& view) const {
    DeviceScene* scene = nullptr;
    const TraceStatus status = device_pack_.device->load(&view, &scene);
    if (status == trace_too_deep)
        throw std::runtime_error("the scene has more levels than the device's kernels support");
    expect_ok(status, "copying the scene");
    return {scene, device_pack_.device->unload};
}

OpenDevice::Slot OpenDevice::make_slot(std::uint64_t rays, std::uint64_t hits) const {
    DeviceSlot* slot = nullptr;
    expect_ok(device_pack_.device->make_slot(rays, hits, &slot), "making a slot");
    return {slot, device_pack_.device->free_slot};
}

std::string OpenDevice::pin(void* memory, std::uint64_t bytes) const {
    const bool pinned = device_pack_.device->pin(memory, bytes) == trace_ok;
    return pinned ? std::string() : device_pack_.device->error();
}

void OpenDevice::start(const Slot& slot, const Scene& scene, TraceFunction kernel,
                       const TraceCall& call, const PinholeRays* made) const {
    expect_ok(device_pack_.device->start(slot.get(), scene.get(), kernel, &call, made),
              "starting a call");
}

double OpenDevice::finish(const Slot& slot) const {
    double seconds = 0;
    expect_ok(device_pack_.device->finish(slot.get()), "finishing a call");
    expect_ok(device_pack_.device->kernel_seconds(slot.get(), &seconds), "timing a kernel");
    return seconds;
}

void OpenDevice::expect_ok(TraceStatus status, const std::string& step) const {
    if (status == trace_ok) return;
    if (status == trace_bad_call) throw std::runtime_error(step + ": the pack refused the call");
    throw std::runtime_error(step + ": " + device_pack_.device->error());
}

}  // namespace raynest::bench
